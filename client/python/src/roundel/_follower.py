"""What a stream of snapshots goes through, whoever drives it: received, lost, tried again, back."""

from __future__ import annotations

import logging
import threading

from roundel import v1
from roundel._backoff import Backoff
from roundel.errors import RoundelError, ServerError, Unreachable
from roundel.snapshot import Disconnected, Reconnected, Snapshot, Update

log = logging.getLogger("roundel")


class Follower:
    """Turns messages and errors into updates. Pure but for the log: it neither waits nor sends."""

    def __init__(self) -> None:
        self.backoff = Backoff()
        self.missed = 0
        """Snapshots missed so far, by slowness and without a connection."""
        self._newest: tuple[str, int] | None = None
        self._was_lost = False

    def received(self, message: v1.Snapshot) -> list[Update]:
        """A snapshot, after word that the connection is back if it was lost."""
        self.backoff.reset()
        before, self._newest = self._newest, (message.source_id, message.sequence)
        snapshot = Snapshot(message)
        self.missed += message.missed
        if not self._was_lost:
            return [snapshot]
        self._was_lost = False
        missed: int | None = None
        if before is not None and before[0] == message.source_id:
            missed = max(message.sequence - before[1] - 1, 0)
            self.missed += missed
        log.warning("connected again, %s", "to a server that was started anew" if missed is None else f"{missed} missed")
        return [Reconnected(missed), snapshot]

    def lost(self, error: RoundelError) -> Disconnected:
        """Word of the loss, with the pause before the next try; raises what asking again cannot heal."""
        if not error.is_temporary:
            raise error
        self._was_lost = True
        tries, retry_in_s = self.backoff.tries, self.backoff.next_pause_s()
        if isinstance(error, Unreachable):
            reason = error.reason
        elif isinstance(error, ServerError):
            reason = error.message
        else:
            reason = str(error)
        log.warning("connection lost: %s; next try in %.1f s", reason, retry_in_s)
        return Disconnected(reason, tries, retry_in_s)


class Newest:
    """A place for the newest snapshot: who puts never waits, who takes gets no old ones."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.value: Snapshot | None = None
        self.skipped = 0
        """Snapshots that were replaced before anybody took them."""
        self.is_taken = True
        self.failure: BaseException | None = None
        self.is_closed = False

    def put(self, snapshot: Snapshot) -> None:
        with self.changed:
            self.skipped += not self.is_taken
            self.value, self.is_taken = snapshot, False
            self.changed.notify_all()

    def end(self, failure: BaseException | None) -> None:
        with self.changed:
            self.failure, self.is_closed = failure, True
            self.changed.notify_all()
