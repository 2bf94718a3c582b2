"""Which snapshots, and what of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from roundel import _calls, v1


@dataclass(frozen=True)
class Subscription:
    """Which snapshots a client wants; all of everything by default."""

    ids: Sequence[int] = ()
    """Only these objects, by object_id; empty: all."""
    roundels: Sequence[str] = ()
    """Only objects of these kinds of roundel, by configured name; empty: all."""
    region_m: tuple[Sequence[float], Sequence[float]] | None = None
    """Only objects within the box between two corners of the world frame; a side may be infinite."""
    max_rate_hz: float | None = None
    """At most this many snapshots a second."""
    horizon_s: float = 0.0
    """Every pose predicted this far past the server's pose time, up to a second, with its covariance."""
    covariance: bool = True
    """Without: less than half the bytes."""

    def request(self) -> v1.SubscribeSnapshotsRequest:
        """The message that asks for it."""
        request = v1.SubscribeSnapshotsRequest(
            object_ids=list(self.ids), roundels=list(self.roundels), omit_covariance=not self.covariance
        )
        if self.region_m is not None:
            request.region.CopyFrom(_calls.region(self.region_m))
        if self.max_rate_hz is not None:
            request.max_rate_hz = self.max_rate_hz
        if self.horizon_s:
            request.horizon_ms = self.horizon_s * 1e3
        return request
