"""What a stream of snapshots goes through, whoever drives it: received, lost, tried again, back."""

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
    """Turns messages and errors into updates; it neither waits nor sends. `logs`, if nobody else tells of losses."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic, logs: bool = False) -> None:
        self._logs = logs
        self.backoff = Backoff()
        self.missed = 0
        """Snapshots missed so far, by slowness and without a connection."""
        self.link = Link()
        self._clock_s = clock_s
        self._newest: tuple[str, int] | None = None
        self._arrived_s: float | None = None

    @property
    def age_s(self) -> float:
        """How long ago the newest snapshot came; infinite before the first."""
        return float("inf") if self._arrived_s is None else self._clock_s() - self._arrived_s

    def received(self, message: v1.Snapshot) -> list[Update]:
        """A snapshot, after word that the connection is back if it was lost."""
        self.backoff.reset()
        before, self._newest = self._newest, (message.source_id, message.sequence)
        gap_s, self._arrived_s = self.age_s, self._clock_s()
        was, self.link = self.link, dataclasses.replace(self.link, state=LinkState.CONNECTED, tries=0)
        snapshot = Snapshot(message)
        self.missed += message.missed
        if was.state is not LinkState.LOST or before is None:
            # The first one there is comes back from nowhere, however many tries it took.
            if was.tries:
                self._say("connected after %d tries in vain", was.tries)
            return [snapshot]
        restarted = before[0] != message.source_id
        self.link = dataclasses.replace(self.link, restarts=self.link.restarts + restarted)
        missed: int | None = None
        if not restarted:
            missed = max(message.sequence - before[1] - 1, 0)
            self.missed += missed
        told = "to a server that was started anew" if restarted else f"{missed} missed"
        self._say("connected again after %.1f s, %s", gap_s, told)
        return [Reconnected(missed, restarted, gap_s), snapshot]

    def lost(self, error: RoundelError) -> Disconnected:
        """Word of the loss, with the pause before the next try; raises what asking again cannot heal."""
        if isinstance(error, NotRoundel) and not error.speaks_http2 and self._newest is not None:
            # The server was there: a proxy before it answers while it starts anew.
            error = Unreachable(error.address, "what answers there speaks no HTTP/2")
        if not error.is_temporary:
            self.end(error)
            raise error
        tries, retry_in_s = self.backoff.tries, self.backoff.next_pause_s()
        losses = self.link.losses + self.link.is_up
        state = LinkState.CONNECTING if self._newest is None else LinkState.LOST
        # The first word after a snapshot is of the loss; every other one is of a try.
        in_vain = tries + (self._newest is None)
        self.link = Link(state, error, in_vain, losses, self.link.restarts)
        if isinstance(error, Unreachable):
            reason = error.reason
        elif isinstance(error, ServerError):
            reason = error.message
        else:
            reason = str(error)
        what = "no connection yet" if self._newest is None else "connection lost"
        self._say("%s: %s; next try in %.1f s", what, reason, retry_in_s)
        return Disconnected(reason, in_vain, retry_in_s)

    def end(self, error: RoundelError | None = None) -> None:
        """Nothing will come any more."""
        self.link = dataclasses.replace(self.link, state=LinkState.ENDED, error=error or self.link.error)

    def recent(self, newest: Snapshot | None, longest_s: float) -> Snapshot:
        """The newest snapshot, if it came so short a time ago."""
        age_s = self.age_s
        if newest is None or age_s > longest_s:
            raise Stale(longest_s, age_s, self.link)
        return newest

    def _say(self, text: str, *words: object) -> None:
        if self._logs:
            log.warning(text, *words)
