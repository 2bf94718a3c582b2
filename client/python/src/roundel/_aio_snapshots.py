"""Snapshots for asyncio, through losses of the connection."""

from __future__ import annotations

import asyncio
from collections import deque
from types import TracebackType
from typing import TYPE_CHECKING, Any, AsyncIterator

import grpc
import grpc.aio

from roundel._follower import Follower
from roundel.errors import RoundelError, Unreachable, from_rpc
from roundel.snapshot import Snapshot, Update
from roundel.subscription import Subscription

if TYPE_CHECKING:
    from roundel.aio import Client


class Snapshots(AsyncIterator[Update]):
    """Snapshots, and word of connections lost and back; ends when closed, or with an error that asking again cannot heal."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._client = client
        self._request = subscription.request()
        self._follower = Follower()
        self._held: deque[Update] = deque()
        self._messages: Any = None
        self._pause_s = 0.0
        self._is_closed = False

    @property
    def missed(self) -> int:
        """Snapshots missed so far, since this client was too slow for them or had no connection."""
        return self._follower.missed

    def close(self) -> None:
        """Ends the stream."""
        self._is_closed = True
        if self._messages is not None:
            self._messages.cancel()

    def __aiter__(self) -> Snapshots:
        return self

    async def __anext__(self) -> Update:
        if not self._held:
            if self._pause_s:
                await asyncio.sleep(self._pause_s)
                self._pause_s = 0.0
            await self._receive()
        return self._held.popleft()

    async def _receive(self) -> None:
        if self._is_closed:
            raise StopAsyncIteration
        try:
            if self._messages is None:
                self._messages = self._client._open("SubscribeSnapshots", self._request)
            message = await self._messages.read()
        except grpc.aio.AioRpcError as failure:
            self._lost(from_rpc(self._client.address, failure))
        except asyncio.CancelledError:
            # Closed by another task, and not a cancellation of this one.
            if self._is_closed:
                raise StopAsyncIteration from None
            raise
        else:
            if message is grpc.aio.EOF:  # type: ignore[attr-defined]
                self._lost(Unreachable(self._client.address, "the server ended the stream"))
            else:
                self._held.extend(self._follower.received(message))

    def _lost(self, error: RoundelError) -> None:
        self._messages = None
        update = self._follower.lost(error)
        self._pause_s = update.retry_in_s
        self._held.append(update)


class Latest:
    """The newest snapshot at any time. A task reads; whoever asks gets the newest, and nothing waits for it."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._updates = Snapshots(client, subscription)
        self._value: Snapshot | None = None
        self._fresh = asyncio.Event()
        self.skipped = 0
        """Snapshots that came and were replaced before anybody took them."""
        self._reader = asyncio.create_task(self._read(), name="roundel-latest")

    @property
    def value(self) -> Snapshot | None:
        """The newest snapshot; None before the first. Does not wait."""
        self._fresh.clear()
        return self._value

    @property
    def missed(self) -> int:
        """Snapshots that never came, as of :attr:`Snapshots.missed`."""
        return self._updates.missed

    async def next(self) -> Snapshot:
        """The newest snapshot that nobody has taken yet; waits for one."""
        fresh = asyncio.create_task(self._fresh.wait())
        try:
            await asyncio.wait({fresh, self._reader}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            fresh.cancel()
        if self._fresh.is_set() and self._value is not None:
            self._fresh.clear()
            return self._value
        # The reader has ended: with an error, or since it was closed.
        await self._reader
        raise StopAsyncIteration

    def __aiter__(self) -> Latest:
        return self

    async def __anext__(self) -> Snapshot:
        return await self.next()

    async def close(self) -> None:
        """Ends the stream and its task."""
        self._updates.close()
        self._reader.cancel()
        await asyncio.gather(self._reader, return_exceptions=True)

    async def __aenter__(self) -> Latest:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _read(self) -> None:
        async for update in self._updates:
            if isinstance(update, Snapshot):
                self.skipped += self._fresh.is_set()
                self._value = update
                self._fresh.set()
