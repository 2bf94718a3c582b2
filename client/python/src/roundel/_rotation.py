"""Arrays of Hamilton quaternions, stored x y z w."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def product(a: Floats, b: Floats) -> Floats:
    """Rotations by `b`, then by `a`; shapes (n, 4)."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def from_rotation_vector(vector_rad: Floats) -> Floats:
    """Axis times angle (n, 3) as quaternions (n, 4)."""
    angle_rad = np.linalg.norm(vector_rad, axis=-1, keepdims=True)
    # sin(angle/2) / angle, which is 1/2 at 0.
    scale = 0.5 * np.sinc(angle_rad / (2.0 * np.pi))
    return np.concatenate([vector_rad * scale, np.cos(angle_rad / 2.0)], axis=-1)


def matrices(quaternions: Floats) -> Floats:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows, dtype=np.float64), -1, 0)
