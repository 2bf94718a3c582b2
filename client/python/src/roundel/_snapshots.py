# Generated from aio/_snapshots.py by generate_sync.py. Do not edit.
"""Streams of snapshots that survive lost connections."""

from __future__ import annotations

from collections import deque
from types import TracebackType
from typing import TYPE_CHECKING, Any, Iterator

import grpc

from roundel._concurrency import SyncCondition, SyncEvent, SyncReader
from roundel._stream_state import StreamState, log
from roundel.errors import Closed, RoundelError, Stale, Unreachable, from_rpc
from roundel.link import Link
from roundel.snapshot import Snapshot, Update
from roundel.subscription import Subscription

if TYPE_CHECKING:
    from .client import Client


class Snapshots(Iterator[Update]):
    """Snapshots, with an update when the connection is lost and when it is back.

    Ends at once when it or its client is closed. Raises errors that a retry cannot fix, such as a refused
    subscription, and ends after that.
    """

    def __init__(self, client: Client, subscription: Subscription, logs: bool = False) -> None:
        self._client = client
        self._request = subscription.request()
        self._state = StreamState(logs=logs)
        self._pending: deque[Update] = deque()
        self._messages: Any = None
        self._pause_s = 0.0
        self._closed = SyncEvent()
        client._register(self)

    @property
    def missed(self) -> int:
        """Snapshots missed so far: this client read too slowly, or had no connection."""
        return self._state.missed

    @property
    def link(self) -> Link:
        """The current state of the connection."""
        return self._state.link

    @property
    def age_s(self) -> float:
        """Time since the newest snapshot arrived; infinite before the first."""
        return self._state.age_s

    def close(self) -> None:
        """Ends the stream, also while another task or thread waits for its next value."""
        self._closed.set()
        messages = self._messages
        if messages is not None:
            messages.cancel()

    def __enter__(self) -> Snapshots:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Snapshots:
        return self

    def __next__(self) -> Update:
        while not self._closed.is_set():
            if self._pending:
                return self._pending.popleft()
            pause_s, self._pause_s = self._pause_s, 0.0
            if not (pause_s and self._closed.wait_for(pause_s)):
                self._receive()
        self._state.end()
        raise StopIteration

    def _receive(self) -> None:
        try:
            if self._messages is None:
                self._messages = self._client._open("SubscribeSnapshots", self._request, self._closed)
            if self._closed.is_set():
                self._messages.cancel()
                return
            message = self._messages.read()
        except Closed:
            self._closed.set()
        except grpc.RpcError as failure:
            if not self._closed.is_set():
                self._lost(from_rpc(self._client.address, failure))
        except RoundelError as error:
            if not self._closed.is_set():
                self._lost(error)
        else:
            if message is not None:
                self._pending.extend(self._state.received(message))
            elif not self._closed.is_set():
                self._lost(Unreachable(self._client.address, "the server ended the stream"))

    def _lost(self, error: RoundelError) -> None:
        self._messages = None
        try:
            update = self._state.lost(error)
        except RoundelError:
            self._closed.set()
            raise
        self._pause_s = update.retry_in_s
        self._pending.append(update)


class Latest:
    """The newest snapshot, read in the background. Readers get the newest one; nothing is queued.

    While there is no connection the newest snapshot stays and grows old. :meth:`recent`, and :meth:`next` with a
    timeout, raise :class:`Stale` then; :attr:`age_s` and :attr:`link` give the details.
    """

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._updates = Snapshots(client, subscription, logs=True)
        self._changed = SyncCondition()
        self._value: Snapshot | None = None
        self._is_taken = True
        self._skipped = 0
        self._failure: Exception | None = None
        self._is_ended = False
        self._reader = SyncReader(self._read, name="roundel-latest")

    @property
    def value(self) -> Snapshot | None:
        """The newest snapshot, however old; None before the first. Does not wait."""
        with self._changed:
            self._is_taken = True
            return self._value

    @property
    def age_s(self) -> float:
        """Time since the newest snapshot arrived; infinite before the first."""
        return self._updates.age_s

    @property
    def link(self) -> Link:
        """The current state of the connection, with its last error."""
        return self._updates.link

    @property
    def skipped(self) -> int:
        """Snapshots that arrived and were replaced before they were read."""
        return self._skipped

    @property
    def missed(self) -> int:
        """Snapshots that never arrived, as in :attr:`Snapshots.missed`."""
        return self._updates.missed

    def recent(self, longest_s: float) -> Snapshot:
        """The newest snapshot if it arrived within the last `longest_s`, otherwise raises :class:`Stale`. Does not wait.

        Also raises the error that ended the stream, such as :class:`Refused` or :class:`Closed`.
        """
        with self._changed:
            if self._is_ended:
                raise self._end()
            snapshot = self._updates._state.recent(self._value, longest_s)
            self._is_taken = True
            return snapshot

    def next(self, timeout_s: float | None = None) -> Snapshot:
        """The newest snapshot that has not been read yet; waits for one.

        Raises :class:`Stale`, a TimeoutError, after `timeout_s`, and the error that ended the stream, such as
        :class:`Refused` or :class:`Closed`.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: self._is_ended or not self._is_taken, timeout_s):
                raise Stale(timeout_s or 0.0, self.age_s, self.link)
            if self._is_ended:
                raise self._end()
            assert self._value is not None
            self._is_taken = True
            return self._value

    def __iter__(self) -> Latest:
        """Iterates over :meth:`next` until the stream is closed."""
        return self

    def __next__(self) -> Snapshot:
        try:
            return self.next()
        except Closed:
            raise StopIteration from None

    def close(self) -> None:
        """Ends the stream and its background reader."""
        self._updates.close()
        self._reader.join()

    def __enter__(self) -> Latest:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _end(self) -> Exception:
        return self._failure or Closed("stream of snapshots")

    def _read(self) -> None:
        failure: Exception | None = None
        try:
            for update in self._updates:
                if isinstance(update, Snapshot):
                    with self._changed:
                        self._skipped += not self._is_taken
                        self._value, self._is_taken = update, False
                        self._changed.notify_all()
        except Exception as error:
            # Also an unexpected one: readers raise it instead of waiting forever.
            log.error("%s", error)
            failure = error
        finally:
            with self._changed:
                self._failure, self._is_ended = failure, True
                self._changed.notify_all()
