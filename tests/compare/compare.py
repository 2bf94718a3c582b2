"""Judges detectors on the scenes that tests/compare/run renders.

compare.py markers MARKERS.json           the cells of the markers to render
compare.py judge FOLDER BENCH REPETITIONS the table

Times are the least of the repetitions, and Roundel is timed before and after the others of each scene, so
that a busy machine disturbs all alike. Everything runs on one thread. A marker counts as found where its
middle lies within 3 px of the truth.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from pupil_apriltags import Detector as AprilTag

FAMILIES = {"aruco": cv2.aruco.DICT_4X4_1000, "apriltag": cv2.aruco.DICT_APRILTAG_36H11}
CELLS = {"aruco": 6, "apriltag": 8}
PHOTOGRAPH = Path("../shared/data/real/negatives/vf_squareC1.jpeg")
NEAR_PX = 3.0
# Scenes with one marker.
FOCAL_PX = 1100.0


def write_markers(path):
    markers = {}
    for family, number in FAMILIES.items():
        dictionary = cv2.aruco.getPredefinedDictionary(number)
        cells = CELLS[family]
        images = [cv2.aruco.generateImageMarker(dictionary, i, cells) for i in range(400)]
        markers[family] = [(image > 127).astype(int).tolist() for image in images]
    Path(path).write_text(json.dumps(markers))


def aruco_detector(refinement):
    """refinement: one of cv2.aruco.CORNER_REFINE_*."""
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES["aruco"])
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def aruco(refined):
    subpixel, none = cv2.aruco.CORNER_REFINE_SUBPIX, cv2.aruco.CORNER_REFINE_NONE
    detector = aruco_detector(subpixel if refined else none)
    return lambda image: [corners[0] for corners in detector.detectMarkers(image)[0]]


def apriltag(decimate):
    detector = AprilTag(families="tag36h11", nthreads=1, quad_decimate=decimate)
    return lambda image: [np.array(tag.corners, np.float32) for tag in detector.detect(image)]


def blob(largest=None):
    """largest: area of a blob, pixels; OpenCV's default is 5000."""
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.maxArea = largest or parameters.maxArea
    detector = cv2.SimpleBlobDetector_create(parameters)
    return lambda image: detector.detect(image)


# What is timed: name, which rendering it sees, how it is called.
OTHERS = [
    ("ArUco", "aruco", aruco(False)),
    ("ArUco, corners refined", "aruco", aruco(True)),
    ("AprilTag, full resolution", "apriltag", apriltag(1.0)),
    ("AprilTag, half resolution", "apriltag", apriltag(2.0)),
    ("SimpleBlobDetector", "disc", blob()),
]


def place(found):
    """Middle of a square's corners (where its diagonals meet) or of a blob."""
    if isinstance(found, cv2.KeyPoint):
        return np.array(found.pt)
    a, b, c, d = (np.array(corner, float) for corner in found)
    share = np.linalg.solve(np.column_stack([c - a, b - d]), b - a)[0]
    return a + share * (c - a)


def pose(found, size, camera, distortion):
    """Rotation vector and middle (metres) of a square of this side before this camera, by solvePnP.

    The square's x points to the right of its print and its y up.
    """
    h = size / 2
    corners = np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])
    # AprilTag lists its corners the other way round.
    points = np.array(found, float)
    if np.linalg.det([points[1] - points[0], points[2] - points[1]]) < 0:
        points = points[::-1]
    flag = cv2.SOLVEPNP_IPPE_SQUARE
    _, turn, shift = cv2.solvePnP(corners, points, camera, distortion, flags=flag)
    return turn.ravel(), shift.ravel()


def position(found, size, camera, distortion):
    """Middle of a square of this side before this camera, metres."""
    return pose(found, size, camera, distortion)[1]


def depth(found, image, truth):
    """Distance from the camera, metres, by solvePnP of a square or by the size of a blob."""
    focal, size = FOCAL_PX, truth["size_m"]
    if isinstance(found, cv2.KeyPoint):
        return focal * size / found.size
    height, width = image.shape
    camera = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return float(np.linalg.norm(position(found, size, camera, np.zeros(5))))


def matched(places, truths):
    """How many of the truths have a place near them, and how many places have none."""
    left = [np.array(truth["center_px"]) for truth in truths]
    wrong = 0
    for at in places:
        distances = [np.linalg.norm(at - other) for other in left]
        if distances and min(distances) < NEAR_PX:
            left.pop(int(np.argmin(distances)))
        else:
            wrong += 1
    return len(truths) - len(left), wrong


def least_ms(run, image, repetitions):
    times = []
    for _ in range(repetitions):
        begun = time.perf_counter()
        found = run(image)
        times.append(time.perf_counter() - begun)
    return 1e3 * min(times), found


class Roundel:
    def __init__(self, bench, truth, focal, repetitions):
        numbers = [focal, 1e3 * truth["size_m"], 1e3 * truth["inner_m"], repetitions]
        self.command = [bench] + [str(number) for number in numbers]

    def run(self, paths):
        lines = subprocess.run(
            self.command + [str(path) for path in paths], check=True, capture_output=True, text=True
        ).stdout.splitlines()
        return [json.loads(line) for line in lines]


def row(name, milliseconds, ours, found, of, wrong):
    ratio = f"{milliseconds / ours:7.1f}" if ours else ""
    print(f"| {name:32} | {milliseconds:8.3f} | {ratio:>7} | {found:4} of {of:<4} | {wrong:5} |")


def head(title):
    print(f"\n{title}\n")
    print(f"| {'':32} | {'ms':>8} | {'ratio':>7} | {'found':12} | {'false':5} |")
    print(f"| {'-' * 32} | {'-' * 7}: | {'-' * 6}: | {'-' * 12} | {'-' * 4}: |")


def speed(title, name, truths, folder, roundel, repetitions, picture=None):
    """First search of one scene; picture: one that all see."""
    path = lambda rendering: picture or folder / f"{name}-{rendering}.pgm"
    ours = roundel.run([path("roundel")])
    others = []
    for label, rendering, run in OTHERS:
        image = cv2.imread(str(path(rendering)), cv2.IMREAD_GRAYSCALE)
        others.append((label, *least_ms(run, image, max(5, repetitions // 2))))
    again = roundel.run([path("roundel")])
    head(title)
    fast = min(ours[0]["first_us"], again[0]["first_us"]) / 1e3
    for line, other in zip(ours, again):
        count, wrong = matched([np.array(f["center_px"]) for f in line["found"]], truths)
        first = min(line["first_us"], other["first_us"]) / 1e3
        row(f"Roundel {line['mode']}, first search", first, fast, count, len(truths), wrong)
        if truths:
            next_frame = min(line["tracked_us"], other["tracked_us"]) / 1e3
            row(f"Roundel {line['mode']}, followed", next_frame, fast, count, len(truths), wrong)
    for label, milliseconds, found in others:
        count, wrong = matched([place(f) for f in found], truths)
        row(label, milliseconds, fast, count, len(truths), wrong)


def precision(diameter, truth, folder, roundel):
    names = sorted(name for name in truth["scenes"] if name.startswith(f"single-{diameter:03}"))
    true = {name: truth["scenes"][name]["markers"][0] for name in names}
    errors = {}

    def note(label, name, distance):
        exact = np.linalg.norm(true[name]["position_m"])
        errors.setdefault(label, []).append(distance / exact - 1)

    for line in roundel.run([folder / f"{name}-roundel.pgm" for name in names]):
        name = Path(line["image"]).name.removesuffix("-roundel.pgm")
        for found in line["found"][:1]:
            note(f"Roundel {line['mode']}", name, np.linalg.norm(found["position_m"]))
    for label, rendering, run in OTHERS:
        for name in names:
            image = cv2.imread(str(folder / f"{name}-{rendering}.pgm"), cv2.IMREAD_GRAYSCALE)
            for found in run(image)[:1]:
                note(label, name, depth(found, image, truth))
    best = np.sqrt(np.mean(np.square(errors["Roundel precise"])))
    print(f"\nDistance of one marker of {diameter} px, tilt to 50°, blur 0.5 to 1.1 px, noise 1 to 4\n")
    print(f"| {'':32} | rms      | bias      | ratio   | found     |")
    print(f"| {'-' * 32} | -------: | --------: | ------: | --------- |")
    for label in ["Roundel precise", "Roundel fast"] + [label for label, _, _ in OTHERS]:
        if label not in errors:
            print(f"| {label:32} |          |           |         |  0 of {len(names)}  |")
            continue
        error = np.array(errors[label])
        rms, bias = np.sqrt(np.mean(error**2)), np.mean(error)
        print(
            f"| {label:32} | {100 * rms:6.3f} % | {100 * bias:+7.3f} % | {rms / best:7.1f} "
            f"| {len(error):2} of {len(names)}  |"
        )


def judge(folder, bench, repetitions):
    cv2.setNumThreads(1)
    folder = Path(folder)
    truth = json.loads((folder / "truth.json").read_text())
    titles = {
        "1080p-100": "1920x1080 with 100 markers of 24 to 60 px",
        "1080p-400": "1920x1080 with 400 markers of 26 to 34 px",
        "4k-100": "3840x2160 with 100 markers of 24 to 60 px",
    }
    for name, title in titles.items():
        scene = truth["scenes"][name]
        roundel = Roundel(bench, truth, scene["focal_px"], repetitions)
        speed(title, name, scene["markers"], folder, roundel, repetitions)
    if PHOTOGRAPH.exists():
        picture = folder / "photograph.pgm"
        cv2.imwrite(str(picture), cv2.imread(str(PHOTOGRAPH), cv2.IMREAD_GRAYSCALE))
        size = "x".join(map(str, cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE).shape[::-1]))
        roundel = Roundel(bench, truth, FOCAL_PX, repetitions)
        speed(f"A cluttered photograph of {size}", "", [], folder, roundel, repetitions, picture)
    else:
        print(f"\nskipped: the photograph needs {PHOTOGRAPH}")
    for diameter in (20, 30, 60, 100):
        precision(diameter, truth, folder, Roundel(bench, truth, FOCAL_PX, 1))


if __name__ == "__main__":
    if sys.argv[1] == "markers":
        write_markers(sys.argv[2])
    else:
        judge(sys.argv[2], sys.argv[3], int(sys.argv[4]))
        # The wheel of AprilTag crashes when the interpreter takes down two detectors.
        sys.stdout.flush()
        os._exit(0)
