"""OpenCV's calibrateCamera on the chessboard's pictures in a folder, beside what Roundel's board gave there."""

import json
import pathlib
import sys

import cv2
import numpy as np

# What Roundel's reprojection error may be, of OpenCV's.
MOST_RATIO = 1.3

folder = pathlib.Path(sys.argv[1])
board = json.loads((folder / "board.json").read_text())
columns, rows = board["corners"]
model = np.zeros((rows * columns, 3), np.float32)
model[:, :2] = np.mgrid[0:columns, 0:rows].T.reshape(-1, 2) * board["square_m"]
objects, corners, size = [], [], None
for path in sorted(folder.glob("chess-*.png")):
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    size = image.shape[::-1]
    found, points = cv2.findChessboardCornersSB(image, (columns, rows), cv2.CALIB_CB_ACCURACY)
    if found:
        objects.append(model)
        corners.append(points)
rms, matrix, *_ = cv2.calibrateCamera(objects, corners, size, None, None)
focal = max(abs(matrix[i, i] / board["focal_px"][i] - 1) for i in (0, 1)) * 100
center = np.hypot(*(matrix[i, 2] - board["center_px"][i] for i in (0, 1)))
ratio = board["rms_px"] / rms
print(f"OpenCV {cv2.__version__}: {len(objects)} views, focal lengths at most {focal:.4f} % off, "
      f"centre {center:.3f} px, rms {rms:.4f} px; Roundel's rms there {board['rms_px']:.4f} px, "
      f"{ratio:.2f} times that")
if len(objects) < 0.8 * len(list(folder.glob("chess-*.png"))):
    sys.exit(f"error: OpenCV found the board in {len(objects)} pictures only, so that nothing is compared")
if ratio > MOST_RATIO:
    sys.exit(f"error: expected Roundel's rms to be at most {MOST_RATIO} times OpenCV's")
