"""The photographs that scikit-image and OpenCV ship on PyPI, as grey PGM files: photographs.py FOLDER.

scikit-image has them in its wheel, OpenCV in its source archive, beside drawings and diagrams: those
are taken too. Both are fetched with pip and only read.
"""

import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

import cv2
import numpy as np

PICTURES = {".png", ".jpg", ".jpeg", ".gif", ".tif", ".bmp", ".webp"}
WHEEL = ["--only-binary=:all:", "scikit-image==0.26.0"]
SOURCE = ["--no-binary=opencv-python-headless", "opencv-python-headless==5.0.0.93"]


def fetch(arguments, folder):
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", folder]
    subprocess.run(command + arguments, check=True)
    return next(Path(folder).iterdir())


def members():
    """Name and bytes of every picture in both packages."""
    with tempfile.TemporaryDirectory() as folder:
        with zipfile.ZipFile(fetch(WHEEL, folder)) as wheel:
            for name in wheel.namelist():
                if name.startswith("skimage/data/"):
                    yield "skimage-" + Path(name).name, wheel.read(name)
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fetch(SOURCE, folder)) as archive:
            for member in archive:
                if member.isfile() and "/opencv/samples/data/" in member.name:
                    name = member.name.split("/opencv/samples/data/")[1].replace("/", "-")
                    yield "opencv-" + name, archive.extractfile(member).read()


out = Path(sys.argv[1])
count = 0
for name, content in members():
    if Path(name).suffix.lower() in PICTURES:
        grey = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
        if grey is None:
            print(f"not decoded: {name}")
            continue
        cv2.imwrite(str(out / (name + ".pgm")), grey)
        count += 1
if count < 100:
    sys.exit(f"expected at least 100 pictures, found {count}")
