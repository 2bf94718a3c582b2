"""Frames of a video as grey PGM files: video.py VIDEO FOLDER."""

import sys
from pathlib import Path

import cv2

video, folder = cv2.VideoCapture(sys.argv[1]), Path(sys.argv[2])
count = 0
while True:
    more, frame = video.read()
    if not more:
        break
    count += 1
    cv2.imwrite(str(folder / f"{count:04}.pgm"), cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
if count == 0:
    sys.exit(f"no frame in {sys.argv[1]}")
