"""Snapshots for asyncio, through losses of the connection."""

from __future__ import annotations

import asyncio
from collections import deque
from types import TracebackType
from typing import TYPE_CHECKING, Any, AsyncIterator

import grpc
import grpc.aio

from roundel._follower import Follower, log
from roundel.errors import Closed, RoundelError, Stale, Unreachable, from_rpc
from roundel.link import Link
from roundel.snapshot import Snapshot, Update
from roundel.subscription import Subscription

if TYPE_CHECKING:
    from roundel.aio import Client


class Snapshots(AsyncIterator[Update]):
    """Snapshots, and word of connections lost and back.

    Ends when it or its client is closed, at once, whatever it waits for; with an error that asking again cannot heal,
    such as a refusal, it ends by raising that.
    """

    def __init__(self, client: Client, subscription: Subscription, logs: bool = False) -> None:
        self._client = client
        self._request = subscription.request()
        self._follower = Follower(logs=logs)
        self._held: deque[Update] = deque()
        self._messages: Any = None
        self._pause_s = 0.0
        self._closed = asyncio.Event()
        client._adopt(self)

    @property
    def missed(self) -> int:
        """Snapshots missed so far, since this client was too slow for them or had no connection."""
        return self._follower.missed

    @property
    def link(self) -> Link:
        """How the connection is now."""
        return self._follower.link

    @property
    def age_s(self) -> float:
        """How long ago the newest snapshot came; infinite before the first."""
        return self._follower.age_s

    def close(self) -> None:
        """Ends the stream; another task that waits for its next value is let go."""
        self._closed.set()
        if self._messages is not None:
            self._messages.cancel()

    async def __aenter__(self) -> Snapshots:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> Snapshots:
        return self

    async def __anext__(self) -> Update:
        while not self._closed.is_set():
            if self._held:
                return self._held.popleft()
            pause_s, self._pause_s = self._pause_s, 0.0
            if not (pause_s and await self._is_closed_within(pause_s)):
                await self._receive()
        self._follower.end()
        raise StopAsyncIteration

    async def _is_closed_within(self, pause_s: float) -> bool:
        try:
            return await asyncio.wait_for(self._closed.wait(), pause_s)
        except asyncio.TimeoutError:
            return False

    async def _receive(self) -> None:
        try:
            if self._messages is None:
                self._messages = self._client._open("SubscribeSnapshots", self._request)
            message = await self._messages.read()
        except Closed:
            self._closed.set()
        except grpc.aio.AioRpcError as failure:
            if not self._closed.is_set():
                self._lost(from_rpc(self._client.address, failure))
        except asyncio.CancelledError:
            # Closed by another task, and not a cancellation of this one.
            if not self._closed.is_set() or is_cancelled():
                raise
        else:
            if message is not grpc.aio.EOF:  # type: ignore[attr-defined]
                self._held.extend(self._follower.received(message))
            elif not self._closed.is_set():
                self._lost(Unreachable(self._client.address, "the server ended the stream"))

    def _lost(self, error: RoundelError) -> None:
        self._messages = None
        try:
            update = self._follower.lost(error)
        except RoundelError:
            # It has been said: who asks on finds the end.
            self._closed.set()
            raise
        self._pause_s = update.retry_in_s
        self._held.append(update)


def is_cancelled() -> bool:
    """Whether somebody wants the task that runs to end; before Python 3.11 nobody can know."""
    task = asyncio.current_task()
    return task is not None and hasattr(task, "cancelling") and task.cancelling() > 0


class Latest:
    """The newest snapshot at any time. A task reads; whoever asks gets the newest, and nothing waits for it.

    While there is no connection the newest one stays, and grows old: :meth:`recent` and :meth:`next` with a timeout
    raise :class:`Stale` then, and :attr:`age_s` and :attr:`link` say more.
    """

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._updates = Snapshots(client, subscription, logs=True)
        self._value: Snapshot | None = None
        self._is_taken = True
        self._skipped = 0
        self._failure: Exception | None = None
        self._is_ended = False
        self._changed = asyncio.Condition()
        self._reader = asyncio.create_task(self._read(), name="roundel-latest")

    @property
    def value(self) -> Snapshot | None:
        """The newest snapshot, however old; None before the first. Does not wait."""
        self._is_taken = True
        return self._value

    @property
    def age_s(self) -> float:
        """How long ago the newest snapshot came; infinite before the first."""
        return self._updates.age_s

    @property
    def link(self) -> Link:
        """How the connection is now, and the last error there was."""
        return self._updates.link

    @property
    def skipped(self) -> int:
        """Snapshots that came and were replaced before anybody took them."""
        return self._skipped

    @property
    def missed(self) -> int:
        """Snapshots that never came, as of :attr:`Snapshots.missed`."""
        return self._updates.missed

    def recent(self, longest_s: float) -> Snapshot:
        """The newest snapshot if it came at most so long ago; else raises :class:`Stale`. Does not wait.

        Raises what ended the stream (:class:`Refused`, :class:`Closed`) too.
        """
        if self._is_ended:
            raise self._end()
        snapshot = self._updates._follower.recent(self._value, longest_s)
        self._is_taken = True
        return snapshot

    async def next(self, timeout_s: float | None = None) -> Snapshot:
        """The newest snapshot that nobody has taken yet; waits for one.

        Raises :class:`Stale`, a TimeoutError, in vain; and what ended the stream: :class:`Refused`, :class:`Closed`.
        """
        if self._is_taken and not self._is_ended:
            try:
                await asyncio.wait_for(self._wait(), timeout_s)
            except asyncio.TimeoutError:
                raise Stale(timeout_s or 0.0, self.age_s, self.link) from None
        if self._is_ended:
            raise self._end()
        assert self._value is not None
        self._is_taken = True
        return self._value

    def __aiter__(self) -> Latest:
        """Each time the newest one that nobody has taken yet, until it is closed."""
        return self

    async def __anext__(self) -> Snapshot:
        try:
            return await self.next()
        except Closed:
            raise StopAsyncIteration from None

    async def close(self) -> None:
        """Ends the stream and its task."""
        self._updates.close()
        if asyncio.current_task() is not self._reader:
            await asyncio.gather(self._reader, return_exceptions=True)

    async def __aenter__(self) -> Latest:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def _end(self) -> Exception:
        return self._failure or Closed("stream of snapshots")

    async def _wait(self) -> None:
        async with self._changed:
            await self._changed.wait_for(lambda: self._is_ended or not self._is_taken)

    async def _read(self) -> None:
        failure: Exception | None = None
        try:
            async for update in self._updates:
                if isinstance(update, Snapshot):
                    self._skipped += not self._is_taken
                    self._value, self._is_taken = update, False
                    await self._tell()
        except Exception as error:
            # A bug too: whoever asks raises it, and is not told that the stream was closed.
            log.error("%s", error)
            failure = error
        finally:
            # Cancelled with its loop too: who waits is to be let go.
            self._failure, self._is_ended = failure, True
        await self._tell()

    async def _tell(self) -> None:
        async with self._changed:
            self._changed.notify_all()
