"""Makes the poses of tests/compare/fmac, and judges the detectors there.

fmac.py poses FOLDER COUNT BLUR_PX    camera, poses and markers' cells, which compare-scenes renders
fmac.py judge FOLDER ROUNDEL          the table; ROUNDEL is the program

Every picture shows one marker and is searched on its own. All systems get the true camera matrix and distortion. The
pose of square markers is OpenCV's solvePnP (IPPE_SQUARE) of their corners; Roundel's is its own. A marker counts as
found if its identity is right (plain roundels have none) and its middle projects to within 3 px of the true one.

Errors are those of the middle in the camera's frame (x right, y down, z forward), the angle between the normals, and
the turn about the normal. Deviations are over the poses that a system found, with all outliers.

The camera is a model of a Logitech C270. Its numbers are typical of calibrations and data sheets of that camera; they
are not the paper's.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from compare import AprilTag, aruco_detector, pose, write_markers

WIDTH, HEIGHT = 640, 480
# Typical calibration at 640x480: focal length and principal point in pixels, k1 k2 p1 p2 k3.
FOCAL_PX = 815.0
CENTER_PX = (320.0, 240.0)
PLUMB_BOB = np.array([0.05, -0.25, 0.0, 0.0, 0.2])
CAMERA = np.array([[FOCAL_PX, 0, CENTER_PX[0]], [0, FOCAL_PX, CENTER_PX[1]], [0, 0, 1]])
# A lens of 4 mm at f/2.8, focused at 0.8 m, which is sharp from 0.4 m to infinity. Pixels of 2.8 µm, binned in pairs.
FOCAL_M = 4e-3
F_NUMBER = 2.8
FOCUS_M = 0.8
PIXEL_M = 5.6e-6
WAVELENGTH_M = 550e-9
# Grey levels, between black ink at 40 and white paper at 200.
NOISE = 2.0
# The renderer's least blur, about what remains of defocus and diffraction at this resolution.
LEAST_BLUR_PX = 0.25

# Outer diameter of roundels, side of square markers, and the disc of plain roundels.
SIZE_M = 0.05
INNER_M = 0.02
# A square's corner with its margin of at most a sixth of the side, which is farther out than a roundel's margin.
REACH_M = SIZE_M * (0.5 + 1 / 6) * np.sqrt(2)
DISTANCES_M = (0.5, 1.5)
MAX_TILT_RAD = np.radians(60)
BASES = (2, 3, 5, 7, 11, 13)

NEAR_PX = 3.0
BITS = 8
# Half a turn about x makes a print, whose z points out of its face, face the camera.
FACING = np.diag([1.0, -1.0, -1.0])


def blur_px(distance, other):
    """Deviation of the Gaussian with the variance of defocus, diffraction and other blur at this distance, pixels.

    Defocus is an even disc of diameter A f |1/focus - 1/distance| with aperture A = f/N, whose deviation along an axis
    is a quarter of the diameter. An Airy pattern is nearly a Gaussian of 0.42 λN. The renderer adds the area of the
    pixels.
    """
    aperture = FOCAL_M / F_NUMBER
    defocus = aperture * FOCAL_PX * abs(1 / FOCUS_M - 1 / distance) / 4
    diffraction = 0.42 * WAVELENGTH_M * F_NUMBER / PIXEL_M
    return max(LEAST_BLUR_PX, float(np.linalg.norm([defocus, diffraction, other])))


def halton(index, base):
    """The index's digits in this base, mirrored at the point."""
    share, step = 0.0, 1.0
    while index > 0:
        step /= base
        share += step * (index % base)
        index //= base
    return share


def rotation(axis, angle):
    return cv2.Rodrigues(np.array(axis, float) * angle)[0]


def from_z_to(direction):
    """The smallest rotation that takes z to this unit vector."""
    axis = np.cross([0, 0, 1], direction)
    sine = np.linalg.norm(axis)
    return rotation(axis / max(sine, 1e-12), np.arctan2(sine, direction[2]))


def posed(index):
    """Position (metres) and rotation of a marker that is wholly in the picture.

    The six coordinates are the two of its middle in the picture, the distance, the tilt against the line of sight (even
    on the sphere), its direction, and the turn about the normal.
    """
    u, v, far, tilt, direction, turn = (halton(index, base) for base in BASES)
    distance = DISTANCES_M[0] + far * (DISTANCES_M[1] - DISTANCES_M[0])
    margin = FOCAL_PX * REACH_M / (distance - REACH_M) + 2
    pixel = [margin + u * (WIDTH - 1 - 2 * margin), margin + v * (HEIGHT - 1 - 2 * margin)]
    x, y = cv2.undistortPoints(np.array([[pixel]]), CAMERA, PLUMB_BOB)[0, 0]
    ray = np.array([x, y, 1]) / np.linalg.norm([x, y, 1])
    angle = np.arccos(1 - tilt * (1 - np.cos(MAX_TILT_RAD)))
    axis = 2 * np.pi * direction
    lean = rotation([np.cos(axis), np.sin(axis), 0], angle)
    spin = rotation([0, 0, 1], 2 * np.pi * turn)
    return distance * ray, from_z_to(ray) @ FACING @ lean @ spin


def write_poses(folder, count, other_blur):
    scenes = []
    for index in range(1, count + 1):
        position, turn = posed(index)
        blur = blur_px(np.linalg.norm(position), other_blur)
        scenes.append(
            {"position_m": position.tolist(), "rotation": turn.tolist(), "blur_px": blur}
        )
    everything = {
        "size_m": SIZE_M,
        "inner_m": INNER_M,
        "width": WIDTH,
        "height": HEIGHT,
        "focal_px": [FOCAL_PX, FOCAL_PX],
        "center_px": CENTER_PX,
        "plumb_bob": PLUMB_BOB.tolist(),
        "noise": NOISE,
        "scenes": scenes,
    }
    (folder / "poses.json").write_text(json.dumps(everything))
    write_markers(folder / "markers.json")
    # A subset of YAML: JSON.
    camera = {
        "image_width": WIDTH,
        "image_height": HEIGHT,
        "camera_matrix": {"rows": 3, "cols": 3, "data": CAMERA.ravel().tolist()},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": PLUMB_BOB.tolist()},
    }
    (folder / "camera.yaml").write_text(json.dumps(camera))


# A detector takes the folder and the scenes' names, and returns for each a list of (identity, position, rotation).
# Identities count from 0 in the order of the family.


def pictures(folder, names, family):
    for name in names:
        yield cv2.imread(str(folder / f"{name}-{family}.pgm"), cv2.IMREAD_GRAYSCALE)


def square(identity, corners):
    turn, position = pose(corners, SIZE_M, CAMERA, PLUMB_BOB)
    return identity, position, cv2.Rodrigues(turn)[0]


def aruco(refinement, shift_px=0.0):
    detector = aruco_detector(refinement)

    def found(image):
        corners, identities, _ = detector.detectMarkers(image)
        identities = [] if identities is None else np.ravel(identities)
        return [square(int(id), points[0] + shift_px) for id, points in zip(identities, corners)]

    return lambda folder, names: [found(image) for image in pictures(folder, names, "aruco")]


def apriltag(decimate, shift_px):
    detector = AprilTag(families="tag36h11", nthreads=1, quad_decimate=decimate)

    def found(image):
        tags = detector.detect(image)
        # OpenCV, which draws the tags, has them upside down: its first corner is AprilTag's third.
        return [square(tag.tag_id, np.roll(tag.corners, 2, axis=0) + shift_px) for tag in tags]

    return lambda folder, names: [found(image) for image in pictures(folder, names, "apriltag")]


def roundel(program, family, mode):
    marker = {
        "roundel": ["--marker", f"{1e3 * SIZE_M}:{1e3 * INNER_M}"],
        "coded": ["--marker", f"{1e3 * SIZE_M}", "--code", f"{BITS}"],
    }[family]

    def found(detection):
        if detection["position_m"] is None:
            return []
        identity = None if detection["id"] is None else detection["id"] - 1
        turn = from_z_to(np.array(detection["normal"]))
        turn = turn @ rotation([0, 0, 1], detection["yaw_rad"] or 0)
        return [(identity, np.array(detection["position_m"]), turn)]

    def run(folder, names):
        command = [program, "detect", "--format", "json", "--mode", mode, *marker]
        command += ["--camera", str(folder / "camera.yaml")]
        command += [str(folder / f"{name}-{family}.pgm") for name in names]
        output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        lines = [json.loads(line) for line in output.splitlines()]
        return [sum(map(found, line["detections"]), []) for line in lines]

    return run


# AprilTag's coordinates have the centre of the first pixel at (0.5, 0.5), where OpenCV's camera models have (0, 0). The
# same holds for OpenCV's copy of its refinement. Taken as they are, such corners shift the pose by half a pixel along x
# and y: 0.6 mm at 1 m.
CORNER_SHIFT_PX = -0.5


def systems(program):
    """Name, number of identities (0: none), and detector."""
    return [
        ("Roundel plain, precise", 0, roundel(program, "roundel", "precise")),
        ("Roundel plain, fast", 0, roundel(program, "roundel", "fast")),
        ("Roundel coded, precise", 30, roundel(program, "coded", "precise")),
        ("Roundel coded, fast", 30, roundel(program, "coded", "fast")),
        ("ArUco", 400, aruco(cv2.aruco.CORNER_REFINE_NONE)),
        ("ArUco, subpixel corners", 400, aruco(cv2.aruco.CORNER_REFINE_SUBPIX)),
        ("ArUco, AprilTag's corners", 400, aruco(cv2.aruco.CORNER_REFINE_APRILTAG, CORNER_SHIFT_PX)),
        ("AprilTag, as delivered", 400, apriltag(1.0, 0.0)),
        ("AprilTag", 400, apriltag(1.0, CORNER_SHIFT_PX)),
        ("AprilTag, half resolution", 400, apriltag(2.0, CORNER_SHIFT_PX)),
    ]


def projected(position):
    return cv2.projectPoints(position, np.zeros(3), np.zeros(3), CAMERA, PLUMB_BOB)[0].ravel()


def best(found, index, identities, truth):
    """The right detection of a picture or None, and the number of others."""
    right = []
    for identity, position, turn in found:
        known = identities == 0 or identity == index % identities
        off = np.linalg.norm(projected(position) - truth["center_px"])
        if known and off < NEAR_PX:
            right.append((off, position, turn))
    if not right:
        return None, len(found)
    _, position, turn = min(right, key=lambda it: it[0])
    return (position, turn), len(found) - 1


def error(estimate, scene, has_yaw):
    """Of the position (mm), the angle between the normals, and the yaw (degrees)."""
    position, turn = estimate
    true = np.array(scene["rotation"])
    off = 1e3 * (position - scene["position_m"])
    cosine = np.clip(turn[:, 2] @ true[:, 2], -1, 1)
    # What remains of the rotation after the smallest one that takes one normal to the other.
    between = true.T @ turn
    yaw = np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1])
    return [*off, np.degrees(np.arccos(cosine)), np.degrees(yaw) if has_yaw else np.nan]


HEADS = ["found", "wrong", "sd x", "y", "z", "bias x", "y", "z", "normal", "rms", "yaw sd", "bias"]
# The paper's figures, from its own renderings.
PAPER = [
    ("ArUco in the paper", ["", "", "5.4", "3.8", "14.7"]),
    ("AprilTag in the paper", ["99.74 %"]),
]


def row(name, cells):
    cells = [*cells, *[""] * (len(HEADS) - len(cells))]
    print(f"| {name:26} | " + " | ".join(f"{cell:>8}" for cell in cells) + " |")


def head(title):
    print(f"\n{title}\n")
    row("", HEADS)
    print(f"| {'-' * 26} | " + " | ".join(["-" * 7 + ":"] * len(HEADS)) + " |")


def errors_row(name, share, wrong, errors):
    if len(errors) == 0:
        row(name, [share, wrong])
        return
    x, y, z, normal, yaw = np.array(errors).T
    cells = [share, wrong]
    cells += [f"{np.std(axis):.2f}" for axis in (x, y, z)]
    cells += [f"{np.mean(axis):+.2f}" for axis in (x, y, z)]
    cells += [f"{np.median(normal):.2f}", f"{np.sqrt(np.mean(normal**2)):.2f}"]
    if not np.isnan(yaw[0]):
        cells += [f"{np.std(yaw):.2f}", f"{np.mean(yaw):+.2f}"]
    row(name, cells)


def judge(folder, cases):
    cv2.setNumThreads(1)
    scenes = json.loads((folder / "poses.json").read_text())["scenes"]
    truths = json.loads((folder / "truth.json").read_text())["scenes"]
    names = sorted(truths)
    results = {}
    for system, identities, run in cases:
        errors, wrong = {}, 0
        for index, found in enumerate(run(folder, names)):
            truth = truths[names[index]]["markers"][0]
            estimate, others = best(found, index, identities, truth)
            wrong += others
            if estimate:
                errors[index] = error(estimate, scenes[index], identities > 0)
        results[system] = errors, wrong
    print("Deviation and bias of the position in mm; angles in degrees, of the normal median and rms")
    head(f"{len(names)} poses of a marker of 50 mm at 0.5 to 1.5 m, tilt to 60°, 640x480")
    for system, (errors, wrong) in results.items():
        share = f"{100 * len(errors) / len(names):.2f} %"
        errors_row(system, share, wrong, list(errors.values()))
    for name, cells in PAPER:
        row(name, cells)
    print("\nIn the paper, the error of AprilTag is 0.62 mm systematically.")
    common = set.intersection(*(set(errors) for errors, _ in results.values()))
    head(f"The same on the {len(common)} poses that all found")
    for system, (errors, _) in results.items():
        errors_row(system, "", "", [errors[index] for index in sorted(common)])


if __name__ == "__main__":
    if sys.argv[1] == "poses":
        write_poses(Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
    else:
        # Kept to the end: the wheel of AprilTag may crash when a second detector is released.
        cases = systems(sys.argv[3])
        judge(Path(sys.argv[2]), cases)
    sys.stdout.flush()
    os._exit(0)
