"""Where objects were, as NumPy arrays."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roundel import v1
from roundel._rotation import Floats


@dataclass(frozen=True)
class Track:
    """The way of one object in one run of the server; row i of each array is the same instant, in the order of time."""

    message: v1.ObjectHistory
    """As it came."""

    @property
    def object_id(self) -> int:
        """Given by the server, anew at each of its starts: see `source_id`."""
        return self.message.object_id

    @property
    def source_id(self) -> str:
        """The run of the server that `object_id` counts in."""
        return self.message.source_id

    @property
    def name(self) -> str:
        """Configured; empty where there is none."""
        return self.message.name

    @property
    def code(self) -> int | None:
        """Number that its teeth say; None where it has none, or was not read."""
        return self.message.code or None

    def __len__(self) -> int:
        return len(self.message.points)

    @functools.cached_property
    def times_ns(self) -> NDArray[np.int64]:
        """Since the Unix epoch, shape (n,)."""
        return np.array([point.time_ns for point in self.message.points], dtype=np.int64)

    @functools.cached_property
    def positions_m(self) -> Floats:
        """World frame, shape (n, 3)."""
        places = (point.position for point in self.message.points)
        return np.array([(at.x, at.y, at.z) for at in places], dtype=np.float64).reshape(-1, 3)

    @functools.cached_property
    def yaws_rad(self) -> Floats:
        """Angle of the object's x axis about the world's z, shape (n,); NaN where it was not observed."""
        points = self.message.points
        return np.array([p.yaw_rad if p.HasField("yaw_rad") else np.nan for p in points], dtype=np.float64)


@dataclass(frozen=True)
class History:
    """Where the objects that were asked for were."""

    message: v1.QueryHistoryResponse
    """As it came."""

    @functools.cached_property
    def tracks(self) -> list[Track]:
        """One for each object and run of the server."""
        return [Track(one) for one in self.message.objects]

    @property
    def step_s(self) -> float:
        """Between points that follow one another."""
        return self.message.step_s

    @property
    def kept_ns(self) -> tuple[int, int]:
        """The oldest and the newest instant that the server's history has; 0 and 0: nothing."""
        return self.message.oldest_time_ns, self.message.newest_time_ns

    def track(self, which: int | str) -> Track | None:
        """The newest run's way of one object, by object_id or by name; None if there is none."""
        found = [one for one in self.tracks if which in (one.object_id, one.name)]
        return max(found, key=lambda one: int(one.times_ns[-1]) if len(one) else 0, default=None)
