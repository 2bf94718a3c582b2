"""Past positions of objects, as NumPy arrays."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roundel import v1
from roundel._rotation import Floats


@dataclass(frozen=True)
class Track:
    """The path of one object in one run of the server. Row i of each array is the same instant, in order of time."""

    message: v1.ObjectHistory

    @property
    def object_id(self) -> int:
        """Assigned by one run of the server; see `source_id`."""
        return self.message.object_id

    @property
    def source_id(self) -> str:
        """The run of the server that assigned `object_id`."""
        return self.message.source_id

    @property
    def name(self) -> str:
        """Configured name; may be empty."""
        return self.message.name

    @property
    def code(self) -> int | None:
        """Number of its code; None without a code, or before it was read."""
        return self.message.code or None

    def __len__(self) -> int:
        return len(self.message.points)

    @functools.cached_property
    def times_ns(self) -> NDArray[np.int64]:
        """Nanoseconds since the Unix epoch, shape (n,)."""
        return np.array([point.time_ns for point in self.message.points], dtype=np.int64)

    @functools.cached_property
    def positions_m(self) -> Floats:
        """World frame, shape (n, 3)."""
        positions = (point.position for point in self.message.points)
        return np.array([(p.x, p.y, p.z) for p in positions], dtype=np.float64).reshape(-1, 3)

    @functools.cached_property
    def yaws_rad(self) -> Floats:
        """Angle of the object's x axis about the world's z, shape (n,); NaN where it was not observed."""
        points = self.message.points
        return np.array([p.yaw_rad if p.HasField("yaw_rad") else np.nan for p in points], dtype=np.float64)


@dataclass(frozen=True)
class History:
    """Past positions of the requested objects."""

    message: v1.QueryHistoryResponse

    @functools.cached_property
    def tracks(self) -> list[Track]:
        """One track for each object and run of the server."""
        return [Track(object) for object in self.message.objects]

    @property
    def step_s(self) -> float:
        """Time between successive points."""
        return self.message.step_s

    @property
    def kept_ns(self) -> tuple[int, int]:
        """The oldest and the newest instant in the server's history; (0, 0) if it is empty."""
        return self.message.oldest_time_ns, self.message.newest_time_ns

    def track(self, which: int | str) -> Track | None:
        """The track of one object, by object_id or name, in its newest run; None if there is none."""
        found = [track for track in self.tracks if which in (track.object_id, track.name)]
        return max(found, key=lambda track: int(track.times_ns[-1]) if len(track) else 0, default=None)
