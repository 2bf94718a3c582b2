"""Offset between the server's clock and this machine's, measured as in NTP (RFC 5905, section 8).

A probe leaves at t1 (own clock), arrives at t2 and is answered at t3 (server's clock), and its answer arrives at t4 (own
clock). The error of offset = ((t2 - t1) + (t3 - t4)) / 2 is at most half the round trip (t4 - t1) - (t3 - t2). The probe
with the shortest round trip is used.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Iterable

from roundel import v1

PROBES = 8
"""Default number of probes."""


@dataclass(frozen=True)
class ClockOffset:
    """How far the server's clock is ahead of this machine's Unix clock."""

    offset_ns: int
    deviation_ns: int
    """Standard deviation, for an error distributed uniformly within its bound."""
    round_trip_ns: int
    """Round trip of the probe that was used."""

    def server_now_ns(self) -> int:
        """Estimate of the server's current time."""
        return time.time_ns() + self.offset_ns

    def to_server_ns(self, own_ns: int) -> int:
        """Converts a time of this machine's clock to the server's."""
        return own_ns + self.offset_ns

    def to_own_ns(self, server_ns: int) -> int:
        """Converts a time of the server's clock to this machine's."""
        return server_ns - self.offset_ns


def best(answers: Iterable[tuple[v1.ServerTime, int]]) -> ClockOffset | None:
    """The offset from the answer with the shortest round trip, given each with its arrival; None if none is plausible."""
    found: ClockOffset | None = None
    for answer, arrival_ns in answers:
        outbound_ns = answer.received_time_ns - answer.sent_time_ns
        return_ns = answer.replied_time_ns - arrival_ns
        round_trip_ns = outbound_ns - return_ns
        if round_trip_ns < 0 or arrival_ns < answer.sent_time_ns:
            # A clock was set during the probe.
            continue
        if found is None or round_trip_ns < found.round_trip_ns:
            deviation_ns = int(round_trip_ns / 2 / math.sqrt(3.0))
            found = ClockOffset((outbound_ns + return_ns) // 2, deviation_ns, round_trip_ns)
    return found
