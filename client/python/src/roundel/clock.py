"""The server's clock against this program's, as NTP measures it (RFC 5905, section 8).

A probe leaves at t1 (own clock), arrives at t2 and is answered at t3 (server's), and its answer is here at t4 (own).
offset = ((t2 - t1) + (t3 - t4)) / 2 is off by at most half of the round trip (t4 - t1) - (t3 - t2). Of some probes the
quickest counts.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Iterable

from roundel import v1

PROBES = 8
"""How many are sent to measure an offset, by default."""


@dataclass(frozen=True)
class ClockOffset:
    """By how much the server's clock is ahead of this machine's Unix clock."""

    offset_ns: int
    deviation_ns: int
    """Standard deviation, taking the error as even within its bound."""
    round_trip_ns: int
    """Of the probe that it comes from."""

    def server_now_ns(self) -> int:
        """The server's time now, as far as this is known."""
        return time.time_ns() + self.offset_ns

    def to_server_ns(self, own_ns: int) -> int:
        """A time of this machine's clock on the server's."""
        return own_ns + self.offset_ns

    def to_own_ns(self, server_ns: int) -> int:
        """A time of the server's clock on this machine's."""
        return server_ns - self.offset_ns


def best(answers: Iterable[tuple[v1.ServerTime, int]]) -> ClockOffset | None:
    """The offset of the quickest of these answers, each with its arrival; None if none makes sense."""
    found: ClockOffset | None = None
    for answer, back_ns in answers:
        there_ns = answer.received_time_ns - answer.sent_time_ns
        here_ns = answer.replied_time_ns - back_ns
        round_trip_ns = there_ns - here_ns
        if round_trip_ns < 0 or back_ns < answer.sent_time_ns:
            # A clock was set meanwhile.
            continue
        if found is None or round_trip_ns < found.round_trip_ns:
            deviation_ns = int(round_trip_ns / 2 / math.sqrt(3.0))
            found = ClockOffset((there_ns + here_ns) // 2, deviation_ns, round_trip_ns)
    return found
