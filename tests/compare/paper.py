"""What OpenCV's detectors find in pictures that `roundel_tests::paper` has rendered, and how long it takes.

paper.py markers COUNT      cells of ArUco markers, as JSON
paper.py judge JOBS.json    for each job and each of its images the least time and what was found, as JSON

A job: detector (aruco, refined or blob), size_m, camera (fx fy cx cy k1 k2 p1 p2 k3, or null: no positions),
repetitions, images. One thread.
"""

import json
import os
import sys

import cv2
import numpy as np
from compare import CELLS, FAMILIES, aruco, blob, least_ms, place, position

DETECTORS = {
    "aruco": lambda: aruco(False),
    "refined": lambda: aruco(True),
    # Discs may be as large as they like.
    "blob": lambda: blob(1e6),
}


def markers(count):
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES["aruco"])
    images = [cv2.aruco.generateImageMarker(dictionary, i, CELLS["aruco"]) for i in range(count)]
    return [(image > 127).astype(int).tolist() for image in images]


def result(found, job):
    entry = {"center_px": place(found).tolist(), "position_m": None}
    if job["camera"] and not isinstance(found, cv2.KeyPoint):
        fx, fy, cx, cy, *distortion = job["camera"]
        camera = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        entry["position_m"] = position(found, job["size_m"], camera, np.array(distortion)).tolist()
    return entry


def judged(job):
    run = DETECTORS[job["detector"]]()
    results = []
    for path in job["images"]:
        image = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
        if image is None:
            sys.exit(f"{path}: expected an image")
        milliseconds, found = least_ms(run, image, job["repetitions"])
        results.append({"ms": milliseconds, "found": [result(one, job) for one in found]})
    return results


if __name__ == "__main__":
    cv2.setNumThreads(1)
    if sys.argv[1] == "markers":
        print(json.dumps(markers(int(sys.argv[2]))))
    else:
        with open(sys.argv[2]) as file:
            print(json.dumps([judged(job) for job in json.load(file)]))
    # As in compare.py, whose AprilTags crash at the interpreter's end.
    sys.stdout.flush()
    os._exit(0)
