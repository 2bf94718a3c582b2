"""Filters for subscriptions to snapshots."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Sequence

from roundel import _calls, v1


@dataclass(frozen=True)
class Subscription:
    """Selects the snapshots and objects that a client receives. The default selects everything."""

    ids: Sequence[int] = ()
    """Only these objects, by object_id, plus those of `names` and `codes`; with all three empty: all.

    A restarted server assigns new ids, so the same id may be another object.
    """
    names: Sequence[str] = ()
    """Objects with these configured names, plus those of `ids` and `codes`."""
    codes: Sequence[int | v1.Code] = ()
    """Objects with these codes, plus those of `ids` and `names`: numbers, or `v1.Code` where there are several layouts."""
    roundels: Sequence[str] = ()
    """Only objects with these kinds of roundel, by configured name; empty: all."""
    region_m: tuple[Sequence[float], Sequence[float]] | None = None
    """Only objects in the box between two corners in the world frame, which may be infinite."""
    max_rate_hz: float | None = None
    """Maximum rate of snapshots; None: every one."""
    horizon_s: float = 0.0
    """Predicts every pose and its covariance this far past the server's pose time, up to a second."""
    covariance: bool = True
    """False halves the message size, but omits accelerations too: `Snapshot.predicted` uses velocities only then."""

    def request(self) -> v1.SubscribeSnapshotsRequest:
        request = v1.SubscribeSnapshotsRequest(max_rate_hz=self.max_rate_hz)
        self._fill(request)
        return request

    def single_request(self) -> v1.GetSnapshotRequest:
        if self.max_rate_hz is not None:
            raise ValueError(f"max_rate_hz: a single snapshot has no rate, found {self.max_rate_hz}")
        request = v1.GetSnapshotRequest()
        self._fill(request)
        return request

    def _fill(self, request: v1.SubscribeSnapshotsRequest | v1.GetSnapshotRequest) -> None:
        for field, values in (("names", self.names), ("roundels", self.roundels)):
            if isinstance(values, str):
                raise ValueError(f"{field}: expected a list of names, found {values!r}; one is [{values!r}]")
        request.object_ids.extend(_checked_integer("ids", "object_id", object_id, 64) for object_id in self.ids)
        request.names.extend(self.names)
        request.codes.extend(
            code if isinstance(code, v1.Code) else v1.Code(number=_checked_integer("codes", "number of a code", code, 32))
            for code in self.codes
        )
        request.roundels.extend(self.roundels)
        request.omit_covariance = not self.covariance
        if self.region_m is not None:
            request.region.CopyFrom(_calls.box(self.region_m))
        if self.horizon_s:
            request.horizon_ms = self.horizon_s * 1e3


def _checked_integer(field: str, what: str, value: int, bits: int) -> int:
    """Returns `value`, also a NumPy integer, as an unsigned integer of at most `bits` bits, or raises ValueError."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if number < 0:
        raise ValueError(f"{field}: expected whole numbers from 0 ({what}), found {value!r}")
    if number >= 1 << bits:
        raise ValueError(f"{field}: expected whole numbers below 2^{bits} ({what}), found {value!r}")
    return number
