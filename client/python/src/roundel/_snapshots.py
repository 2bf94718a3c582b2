"""Snapshots as plain iterators, through losses of the connection."""

from __future__ import annotations

import threading
from collections import deque
from types import TracebackType
from typing import TYPE_CHECKING, Any, Iterator

import grpc

from roundel._follower import Follower, Newest, log
from roundel.errors import RoundelError, Unreachable, from_rpc
from roundel.snapshot import Snapshot, Update
from roundel.subscription import Subscription

if TYPE_CHECKING:
    from roundel.client import Client


class Snapshots(Iterator[Update]):
    """Snapshots, and word of connections lost and back; ends when closed, or with an error that asking again cannot heal."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._client = client
        self._request = subscription.request()
        self._follower = Follower()
        self._held: deque[Update] = deque()
        self._messages: Any = None
        self._pause_s = 0.0
        self._closed = threading.Event()

    @property
    def missed(self) -> int:
        """Snapshots missed so far, since this client was too slow for them or had no connection."""
        return self._follower.missed

    def close(self) -> None:
        """Ends the stream; another thread that waits for its next value is let go."""
        self._closed.set()
        if self._messages is not None:
            self._messages.cancel()

    def __enter__(self) -> Snapshots:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Snapshots:
        return self

    def __next__(self) -> Update:
        if not self._held:
            if self._pause_s and self._closed.wait(self._pause_s):
                raise StopIteration
            self._pause_s = 0.0
            self._receive()
        return self._held.popleft()

    def _receive(self) -> None:
        try:
            if self._messages is None:
                self._messages = self._client._open("SubscribeSnapshots", self._request)
            if self._closed.is_set():
                self._messages.cancel()
                raise StopIteration
            message = next(self._messages, None)
        except grpc.RpcError as failure:
            if self._closed.is_set():
                raise StopIteration from None
            self._lost(from_rpc(self._client.address, failure))
        except ValueError as failure:
            # grpc's word for a channel that was closed.
            raise StopIteration from failure
        else:
            if message is None:
                self._lost(Unreachable(self._client.address, "the server ended the stream"))
            else:
                self._held.extend(self._follower.received(message))

    def _lost(self, error: RoundelError) -> None:
        self._messages = None
        update = self._follower.lost(error)
        self._pause_s = update.retry_in_s
        self._held.append(update)


class Latest:
    """The newest snapshot at any time. A thread reads; whoever asks gets the newest, and nothing waits for it."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._updates = Snapshots(client, subscription)
        self._newest = Newest()
        self._reader = threading.Thread(target=self._read, name="roundel-latest", daemon=True)
        self._reader.start()

    @property
    def value(self) -> Snapshot | None:
        """The newest snapshot; None before the first. Does not wait."""
        with self._newest.changed:
            self._newest.is_taken = True
            return self._newest.value

    @property
    def skipped(self) -> int:
        """Snapshots that came and were replaced before anybody took them."""
        return self._newest.skipped

    @property
    def missed(self) -> int:
        """Snapshots that never came, as of :attr:`Snapshots.missed`."""
        return self._updates.missed

    def next(self, timeout_s: float | None = None) -> Snapshot:
        """The newest snapshot that nobody has taken yet; waits for one, and raises TimeoutError in vain."""
        newest = self._newest
        with newest.changed:
            if not newest.changed.wait_for(lambda: newest.is_closed or not newest.is_taken, timeout_s):
                raise TimeoutError(f"no snapshot within {timeout_s} s")
            if newest.value is not None and not newest.is_taken:
                newest.is_taken = True
                return newest.value
            if newest.failure is not None:
                raise newest.failure
            raise StopIteration

    def __iter__(self) -> Iterator[Snapshot]:
        while True:
            try:
                snapshot = self.next()
            except StopIteration:
                return
            yield snapshot

    def close(self) -> None:
        """Ends the stream and its thread."""
        self._updates.close()
        self._reader.join()

    def __enter__(self) -> Latest:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _read(self) -> None:
        failure: BaseException | None = None
        try:
            for update in self._updates:
                if isinstance(update, Snapshot):
                    self._newest.put(update)
        except RoundelError as error:
            log.error("%s", error)
            failure = error
        self._newest.end(failure)
