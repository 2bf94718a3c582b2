"""How long to wait before the next try."""

from __future__ import annotations

import random

FIRST_S = 0.1
LONGEST_S = 5.0


class Backoff:
    """Pauses that double up to a cap, each shortened at random by up to a half.

    So the clients of a restarted server do not come back all at once.
    """

    def __init__(self) -> None:
        self.tries = 0
        """Since the last success."""

    def next_pause_s(self) -> float:
        """The pause before the next try."""
        doubled_s = FIRST_S * 2.0 ** min(self.tries, 16)
        self.tries += 1
        return min(doubled_s, LONGEST_S) * (1.0 - 0.5 * random.random())

    def reset(self) -> None:
        """It worked: the next pause is short again."""
        self.tries = 0
