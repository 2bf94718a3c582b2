"""State machine of a stream of snapshots: received, lost, retried, restored. Does no I/O, so both clients share it."""

from __future__ import annotations

import dataclasses
import logging
import time
from typing import Callable

from roundel import v1
from roundel._backoff import Backoff
from roundel.errors import NotRoundel, RoundelError, ServerError, Stale, Unreachable
from roundel.link import Link, LinkState
from roundel.snapshot import Disconnected, Reconnected, Snapshot, Update

log = logging.getLogger("roundel")


class StreamState:
    """Turns messages and errors into updates. With `logs`, also logs lost and restored connections."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic, logs: bool = False) -> None:
        self._logs = logs
        self.backoff = Backoff()
        self.missed = 0
        """Snapshots missed so far, by reading slowly and without a connection."""
        self.link = Link()
        self._clock_s = clock_s
        self._newest: tuple[str, int] | None = None
        """`source_id` and `sequence` of the newest snapshot."""
        self._arrived_s: float | None = None

    @property
    def age_s(self) -> float:
        """Time since the newest snapshot arrived; infinite before the first."""
        return float("inf") if self._arrived_s is None else self._clock_s() - self._arrived_s

    def received(self, message: v1.Snapshot) -> list[Update]:
        """The updates for a message: a snapshot, preceded by `Reconnected` after a loss."""
        self.backoff.reset()
        previous, self._newest = self._newest, (message.source_id, message.sequence)
        gap_s, self._arrived_s = self.age_s, self._clock_s()
        old_link, self.link = self.link, dataclasses.replace(self.link, state=LinkState.CONNECTED, tries=0)
        snapshot = Snapshot(message)
        self.missed += message.missed
        if old_link.state is not LinkState.LOST or previous is None:
            if old_link.tries:
                self._log("connected after %d failed attempts", old_link.tries)
            return [snapshot]
        restarted = previous[0] != message.source_id
        self.link = dataclasses.replace(self.link, restarts=self.link.restarts + restarted)
        missed: int | None = None
        if not restarted:
            missed = max(message.sequence - previous[1] - 1, 0)
            self.missed += missed
        outcome = "to a restarted server" if restarted else f"{missed} missed"
        self._log("connected again after %.1f s, %s", gap_s, outcome)
        return [Reconnected(missed, restarted, gap_s), snapshot]

    def lost(self, error: RoundelError) -> Disconnected:
        """The update for a failure, with the pause before the next attempt. Raises errors that a retry cannot fix."""
        if isinstance(error, NotRoundel) and not error.speaks_http2 and self._newest is not None:
            # A proxy answers while the server restarts.
            error = Unreachable(error.address, "a server without HTTP/2 answers there")
        if not error.is_temporary:
            self.end(error)
            raise error
        attempts, retry_in_s = self.backoff.tries, self.backoff.next_pause_s()
        losses = self.link.losses + self.link.is_up
        state = LinkState.CONNECTING if self._newest is None else LinkState.LOST
        # The first failure after a snapshot is the loss itself, and not a failed attempt.
        failed_attempts = attempts + (self._newest is None)
        self.link = Link(state, error, failed_attempts, losses, self.link.restarts)
        if isinstance(error, Unreachable):
            reason = error.reason
        elif isinstance(error, ServerError):
            reason = error.message
        else:
            reason = str(error)
        event = "no connection yet" if self._newest is None else "connection lost"
        self._log("%s: %s; next attempt in %.1f s", event, reason, retry_in_s)
        return Disconnected(reason, failed_attempts, retry_in_s)

    def end(self, error: RoundelError | None = None) -> None:
        """Marks the stream as ended."""
        self.link = dataclasses.replace(self.link, state=LinkState.ENDED, error=error or self.link.error)

    def recent(self, newest: Snapshot | None, longest_s: float) -> Snapshot:
        """Returns `newest` if it arrived within the last `longest_s`; raises `Stale` otherwise."""
        age_s = self.age_s
        if newest is None or age_s > longest_s:
            raise Stale(longest_s, age_s, self.link)
        return newest

    def _log(self, text: str, *values: object) -> None:
        if self._logs:
            log.warning(text, *values)
