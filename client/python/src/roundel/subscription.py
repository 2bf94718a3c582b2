"""Which snapshots, and what of them."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Sequence

from roundel import _calls, v1


@dataclass(frozen=True)
class Subscription:
    """Which snapshots a client wants; all of everything by default."""

    ids: Sequence[int] = ()
    """Only these objects, by object_id, and those of `names` and `codes`; all three empty: all.

    A server that is started anew gives ids anew: after that they are other objects'.
    """
    names: Sequence[str] = ()
    """Likewise those of these configured names, as soon and as long as they have them."""
    codes: Sequence[int | v1.Code] = ()
    """Likewise those that were seen with these codes: their numbers, or `v1.Code` where there are several layouts."""
    roundels: Sequence[str] = ()
    """Only objects of these kinds of roundel, by configured name; empty: all."""
    region_m: tuple[Sequence[float], Sequence[float]] | None = None
    """Only objects within the box between two corners of the world frame; a side may be infinite."""
    max_rate_hz: float | None = None
    """At most this many snapshots a second."""
    horizon_s: float = 0.0
    """Every pose predicted this far past the server's pose time, up to a second, with its covariance."""
    covariance: bool = True
    """Without: less than half the bytes, and no accelerations, so that `Snapshot.predicted` goes by velocities alone."""

    def request(self) -> v1.SubscribeSnapshotsRequest:
        """The message that asks for it."""
        request = v1.SubscribeSnapshotsRequest(max_rate_hz=self.max_rate_hz)
        self._choose(request)
        return request

    def single_request(self) -> v1.GetSnapshotRequest:
        """The message that asks for one snapshot of it."""
        if self.max_rate_hz is not None:
            raise ValueError(f"max_rate_hz: a single snapshot has no rate, found {self.max_rate_hz}")
        request = v1.GetSnapshotRequest()
        self._choose(request)
        return request

    def _choose(self, request: v1.SubscribeSnapshotsRequest | v1.GetSnapshotRequest) -> None:
        for field, words in (("names", self.names), ("roundels", self.roundels)):
            if isinstance(words, str):
                raise ValueError(f"{field}: expected a list of names, found {words!r}; one is [{words!r}]")
        request.object_ids.extend(_whole("ids", "object_id", one, 64) for one in self.ids)
        request.names.extend(self.names)
        request.codes.extend(
            one if isinstance(one, v1.Code) else v1.Code(number=_whole("codes", "number of a code", one, 32))
            for one in self.codes
        )
        request.roundels.extend(self.roundels)
        request.omit_covariance = not self.covariance
        if self.region_m is not None:
            request.region.CopyFrom(_calls.region(self.region_m))
        if self.horizon_s:
            request.horizon_ms = self.horizon_s * 1e3


def _whole(field: str, what: str, value: int, bits: int) -> int:
    """As given, if a message can hold it; NumPy's whole numbers are ones too."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if number < 0:
        raise ValueError(f"{field}: expected whole numbers from 0 ({what}), found {value!r}")
    if number >= 1 << bits:
        raise ValueError(f"{field}: expected whole numbers below 2^{bits} ({what}), found {value!r}")
    return number
