"""Writes the golden numbers that core/tests/golden.rs holds core to, from OpenCV.

OpenCV is needed only to regenerate them; the JSON files are committed. From this directory:

    python3 -m venv venv
    venv/bin/pip install opencv-python-headless==5.0.* numpy
    venv/bin/python generate.py

lens.json    points of the camera frame with their pixels (projectPoints, fisheye.projectPoints), and
             pixels with their undistorted points (undistortPoints, fisheye.undistortPoints, iterated
             until they stand still), for all lens models, weak and strong.
circle.json  circles in space, their rims projected point by point, and the ellipses of those rims:
             by a direct fit, and by the area's moments, which is what a detector measures.

Nothing here uses any code of Roundel's.
"""

import json
import math
from pathlib import Path

import cv2
import numpy as np

HERE = Path(__file__).parent

CAMERAS = [
    # name, width, height, fx, fy, cx, cy, model, coefficients in ROS' order
    ("pinhole", 1920, 1080, 1100.0, 1100.0, 959.5, 539.5, "plumb_bob", [0, 0, 0, 0, 0]),
    ("mild", 1920, 1080, 1100.0, 1098.0, 955.0, 543.0, "plumb_bob", [-0.08, 0.02, 0.0003, -0.0004, 0.0]),
    ("webcam", 1280, 720, 910.0, 912.0, 640.3, 355.1, "plumb_bob", [0.11, -0.25, 0.001, -0.002, 0.08]),
    ("barrel", 1280, 960, 640.0, 642.0, 645.0, 470.0, "plumb_bob", [-0.31, 0.11, 0.0012, -0.0008, -0.018]),
    ("pincushion", 1280, 720, 700.0, 710.0, 630.0, 362.0, "plumb_bob", [0.35, 0.12, -0.002, 0.003, 0.05]),
    ("rational", 1920, 1200, 950.0, 951.0, 962.0, 595.0, "rational_polynomial",
     [8.1, 5.2, 0.0004, -0.0002, 0.21, 8.4, 8.0, 1.3]),
    ("wide", 1280, 800, 520.0, 521.0, 638.0, 402.0, "rational_polynomial",
     [0.65, -0.05, -0.0006, 0.0005, -0.002, 1.02, 0.06, -0.012]),
    ("fisheye", 1280, 1024, 380.0, 381.0, 639.0, 515.0, "equidistant", [-0.02, 0.011, -0.007, 0.0013]),
    ("pure fisheye", 1280, 1024, 420.0, 420.0, 640.0, 512.0, "equidistant", [0, 0, 0, 0]),
]

OUTER_M, INNER_M = 0.16, 0.064


def matrix(camera):
    _, _, _, fx, fy, cx, cy, _, _ = camera
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=float)


def project(camera, points):
    points = np.asarray(points, dtype=float).reshape(-1, 1, 3)
    zero = np.zeros(3)
    distortion = np.array(camera[8], dtype=float)
    if camera[7] == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(points, zero, zero, matrix(camera), distortion)
    else:
        pixels, _ = cv2.projectPoints(points, zero, zero, matrix(camera), distortion)
    return pixels.reshape(-1, 2)


def undistort(camera, pixels):
    pixels = np.asarray(pixels, dtype=float).reshape(-1, 1, 2)
    distortion = np.array(camera[8], dtype=float)
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 5000, 1e-15)
    if camera[7] == "equidistant":
        points = cv2.fisheye.undistortPoints(pixels, matrix(camera), distortion, criteria=until)
    else:
        points = cv2.undistortPoints(pixels, matrix(camera), distortion, criteria=until)
    return points.reshape(-1, 2)


def camera_json(camera):
    name, width, height, fx, fy, cx, cy, lens, distortion = camera
    return {"name": name, "width": width, "height": height, "fx_px": fx, "fy_px": fy,
            "cx_px": cx, "cy_px": cy, "lens": lens, "distortion": [float(k) for k in distortion]}


def lens_cases():
    cases = []
    for camera in CAMERAS:
        _, width, height = camera[:3]
        grid = [(u, v) for v in np.linspace(0, height - 1, 7) for u in np.linspace(0, width - 1, 9)]
        flat = undistort(camera, grid)
        kept = []
        for pixel, point in zip(grid, flat):
            # OpenCV leaves what it cannot undistort unfinished: keep what its projection confirms.
            back = project(camera, [[point[0], point[1], 1.0]])[0]
            if np.hypot(*(back - pixel)) < 1e-10:
                kept.append({"pixel": list(map(float, pixel)), "normalized": list(map(float, point))})
        assert len(kept) > 30, (camera[0], len(kept))
        rng = np.random.default_rng(3)
        points = []
        for entry in kept:
            depth = float(rng.uniform(0.3, 20.0))
            x, y = entry["normalized"]
            jitter = rng.uniform(-0.01, 0.01, 2)
            points.append([(x + jitter[0]) * depth, (y + jitter[1]) * depth, depth])
        projected = [{"point_m": list(map(float, p)), "pixel": list(map(float, q))}
                     for p, q in zip(points, project(camera, points))]
        cases.append({"camera": camera_json(camera), "projected": projected, "undistorted": kept})
    return cases


def circle(position, normal, diameter, count):
    helper = np.array([1.0, 0, 0]) if abs(normal[0]) < 0.7 else np.array([0, 1.0, 0])
    x = np.cross(helper, normal)
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    t = np.arange(count) * (2 * math.pi / count)
    return position + 0.5 * diameter * (np.outer(np.cos(t), x) + np.outer(np.sin(t), y))


def ellipse_json(center, form):
    """The ellipse (p - center)ᵀ form (p - center) = 1."""
    values, vectors = np.linalg.eigh(form)
    major, minor = 1 / math.sqrt(values[0]), 1 / math.sqrt(values[1])
    angle = math.atan2(vectors[1, 0], vectors[0, 0])
    if angle <= -math.pi / 2:
        angle += math.pi
    elif angle > math.pi / 2:
        angle -= math.pi
    return {"center_px": [float(center[0]), float(center[1])], "semi_major_px": major,
            "semi_minor_px": minor, "angle_rad": angle}


def direct_fit(pixels):
    middle = pixels.mean(axis=0)
    scale = np.linalg.norm(pixels - middle, axis=1).mean()
    x, y = ((pixels - middle) / scale).T
    design = np.column_stack([x * x - y * y, 2 * x * y, x, y, np.ones_like(x)])
    a, b, c, d, e = np.linalg.lstsq(design, x * x + y * y, rcond=None)[0]
    form = np.array([[1 - a, -b], [-b, 1 + a]])
    center = np.linalg.solve(form, [c / 2, d / 2])
    level = e + center @ form @ center
    return ellipse_json(middle + scale * center, form / (level * scale * scale))


def by_moments(pixels):
    middle = pixels.mean(axis=0)
    x, y = (pixels - middle).T
    xn, yn = np.roll(x, -1), np.roll(y, -1)
    cross = x * yn - xn * y
    area = cross.sum() / 2
    center = np.array([((x + xn) * cross).sum(), ((y + yn) * cross).sum()]) / (6 * area)
    xx = ((x * x + x * xn + xn * xn) * cross).sum() / (12 * area) - center[0] ** 2
    yy = ((y * y + y * yn + yn * yn) * cross).sum() / (12 * area) - center[1] ** 2
    xy = ((x * yn + 2 * x * y + 2 * xn * yn + xn * y) * cross).sum() / (24 * area) - center[0] * center[1]
    return ellipse_json(middle + center, np.linalg.inv(4 * np.array([[xx, xy], [xy, yy]])))


def grows(camera, bearing):
    """Whether the image still grows outwards here by a third of the rate in its middle."""
    flat = bearing[:2] / bearing[2]
    step = 0.02 * flat
    pixels = project(camera, [np.append(flat - step, 1.0), np.append(flat + step, 1.0)])
    angle = 2 * np.linalg.norm(step) / (1.0 + flat @ flat if camera[7] == "equidistant" else 1.0)
    return np.hypot(*(pixels[1] - pixels[0])) > angle * camera[3] / 3


def circle_cases():
    rng = np.random.default_rng(11)
    cases = []
    for camera in CAMERAS:
        name, width, height, fx = camera[:4]
        while sum(case["camera"] == name for case in cases) < 24:
            # Rims of 10 to 120 px radius, anywhere in the image, tilted by up to 70°.
            margin = 140
            pixel = [rng.uniform(margin, width - margin), rng.uniform(margin, height - margin)]
            bearing = np.append(undistort(camera, [pixel])[0], 1.0)
            if np.hypot(*(project(camera, [bearing])[0] - pixel)) > 1e-9:
                continue
            bearing /= np.linalg.norm(bearing)
            position = bearing * (0.5 * OUTER_M * fx / math.exp(rng.uniform(math.log(10), math.log(120))))
            tilt, turn = rng.uniform(0.05, math.radians(70)), rng.uniform(-math.pi, math.pi)
            across = np.cross(bearing, [0, 1.0, 0])
            across /= np.linalg.norm(across)
            other = np.cross(bearing, across)
            normal = -math.cos(tilt) * bearing + math.sin(tilt) * (
                math.cos(turn) * across + math.sin(turn) * other)
            wider = circle(position, normal, 1.2 * OUTER_M, 16)
            if (wider[:, 2] <= 0).any() or not all(grows(camera, point) for point in wider):
                continue
            rims = {size: project(camera, circle(position, normal, size, 8192))
                    for size in (OUTER_M, INNER_M)}
            if rims[OUTER_M].min() < 0 or (rims[OUTER_M].max(axis=0) > [width - 1, height - 1]).any():
                continue
            if not np.isfinite(rims[OUTER_M]).all():
                continue
            cases.append({
                "camera": name,
                "position_m": list(map(float, position)),
                "normal": list(map(float, normal)),
                "fitted": {"outer": direct_fit(rims[OUTER_M]), "inner": direct_fit(rims[INNER_M])},
                "moments": {"outer": by_moments(rims[OUTER_M]), "inner": by_moments(rims[INNER_M])},
            })
    return {"outer_diameter_m": OUTER_M, "inner_diameter_m": INNER_M,
            "cameras": [camera_json(camera) for camera in CAMERAS], "circles": cases}


def write(name, value):
    text = json.dumps(value, indent=None, separators=(",", ":"))
    # One case a line keeps differences readable.
    (HERE / name).write_text(text.replace('},{"', '},\n{"') + "\n")


if __name__ == "__main__":
    write("lens.json", {"opencv": cv2.__version__, "lenses": lens_cases()})
    write("circle.json", {"opencv": cv2.__version__, **circle_cases()})
