"""Exponential backoff between connection attempts."""

from __future__ import annotations

import random

INITIAL_S = 0.1
MAX_S = 5.0


class Backoff:
    """Pauses that double up to a cap, with random jitter of up to half of each.

    The jitter spreads the reconnections of many clients after a server restart.
    """

    def __init__(self) -> None:
        self.tries = 0
        """Attempts since the last success."""

    def next_pause_s(self) -> float:
        """The pause before the next attempt."""
        doubled_s = INITIAL_S * 2.0 ** min(self.tries, 16)
        self.tries += 1
        return min(doubled_s, MAX_S) * (1.0 - 0.5 * random.random())

    def reset(self) -> None:
        """Starts over with a short pause, after a success."""
        self.tries = 0
