"""Primitives that differ between the asyncio client and the blocking one: locks, background readers, gRPC channels.

Each `Async…` class has a `Sync…` class with the same methods. The blocking client is generated from the asyncio client
(see `generate_sync.py`), which replaces the first prefix by the second.
"""

from __future__ import annotations

import asyncio
import threading
from typing import Any, Callable, Coroutine

import grpc
import grpc.aio

from roundel import _calls
from roundel._trust import Pinned, Trust
from roundel.errors import Closed


class AsyncLock:
    """A lock of one event loop. Does nothing, since tasks switch only at an `await`."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass


SyncLock = threading.Lock


class AsyncEvent(asyncio.Event):
    """An event with a timed wait."""

    async def wait_for(self, timeout_s: float) -> bool:
        """Waits at most `timeout_s`; returns whether the event is set."""
        try:
            return await asyncio.wait_for(self.wait(), timeout_s)
        except asyncio.TimeoutError:
            return self.is_set()


class SyncEvent(threading.Event):
    """An event with a timed wait."""

    def wait_for(self, timeout_s: float) -> bool:
        """Waits at most `timeout_s`; returns whether the event is set."""
        return self.wait(timeout_s)


class AsyncCondition(AsyncLock):
    """A condition variable of one event loop, with the methods of `threading.Condition` that the client uses."""

    def __init__(self) -> None:
        self._notified = asyncio.Event()

    async def wait_for(self, predicate: Callable[[], bool], timeout_s: float | None) -> bool:
        """Waits until `predicate` holds, at most `timeout_s`; returns whether it holds."""
        loop = asyncio.get_running_loop()
        deadline_s = None if timeout_s is None else loop.time() + timeout_s
        while not predicate():
            left_s = None if deadline_s is None else deadline_s - loop.time()
            self._notified.clear()
            try:
                await asyncio.wait_for(self._notified.wait(), left_s)
            except asyncio.TimeoutError:
                return predicate()
        return True

    def notify_all(self) -> None:
        self._notified.set()


SyncCondition = threading.Condition


class AsyncReader:
    """A task that runs in the background."""

    def __init__(self, run: Callable[[], Coroutine[Any, Any, None]], name: str) -> None:
        self._task = asyncio.create_task(run(), name=name)

    async def join(self) -> None:
        """Waits for the end of the task, unless called from it."""
        if asyncio.current_task() is not self._task:
            await asyncio.gather(self._task, return_exceptions=True)


class SyncReader:
    """A daemon thread that runs in the background."""

    def __init__(self, run: Callable[[], None], name: str) -> None:
        self._thread = threading.Thread(target=run, name=name, daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Waits for the end of the thread, unless called from it."""
        if threading.current_thread() is not self._thread:
            self._thread.join()


class AsyncMessages:
    """The messages of one server-streaming call."""

    def __init__(self, call: Any, closed: AsyncEvent) -> None:
        self._call = call
        self._closed = closed

    async def read(self) -> Any:
        """The next message; None at the end of the stream. Raises `grpc.RpcError`."""
        try:
            message = await self._call.read()
        except asyncio.CancelledError:
            # grpc raises this for a cancelled call, too.
            if not self._closed.is_set() or is_cancelled():
                raise
            return None
        return None if message is grpc.aio.EOF else message  # type: ignore[attr-defined]

    def cancel(self) -> None:
        self._call.cancel()


class SyncMessages:
    """The messages of one server-streaming call."""

    def __init__(self, call: Any) -> None:
        self._call = call

    def read(self) -> Any:
        """The next message; None at the end of the stream. Raises `grpc.RpcError`."""
        return next(self._call, None)

    def cancel(self) -> None:
        self._call.cancel()


class _Channel:
    """What both channels share."""

    _trust: Trust
    _channel: Any
    """None until the server's certificate is known, if it is pinned."""
    _closed: AsyncEvent | SyncEvent

    def _method(self, kind: str, name: str) -> Any:
        self._raise_if_closed(None)
        return getattr(self._channel, kind)(_calls.method_path(name), _calls.serialize, _calls.RESPONSES[name].FromString)

    def _raise_if_closed(self, cause: BaseException | None) -> None:
        if self._closed.is_set():
            raise Closed("client") from cause


class AsyncChannel(_Channel):
    """A channel to a server. Calls raise `Closed` once `closed` is set."""

    def __init__(self, trust: Trust, closed: AsyncEvent) -> None:
        self._trust = trust
        self._closed = closed
        self._channel = None if trust.fingerprint else self._create(None)

    def _create(self, pinned: Pinned | None) -> Any:
        return self._trust.channel(grpc.aio.insecure_channel, grpc.aio.secure_channel, pinned)

    async def _ready(self) -> None:
        """Creates the channel, if that has to wait for the server's certificate."""
        if self._channel is None:
            pinned = await asyncio.to_thread(self._trust.fetch)
            self._raise_if_closed(None)
            self._channel = self._channel or self._create(pinned)

    async def unary(self, name: str, request: Any, timeout_s: float) -> Any:
        """The response to a call. Raises `grpc.RpcError`."""
        try:
            await self._ready()
            method = self._method("unary_unary", name)
            return await method(request, timeout=timeout_s, metadata=self._trust.metadata)
        except (grpc.RpcError, grpc.aio.UsageError) as error:
            self._raise_if_closed(error)
            raise
        except asyncio.CancelledError as error:
            if not is_cancelled():
                self._raise_if_closed(error)
            raise

    async def stream(self, name: str, request: Any, closed: AsyncEvent) -> AsyncMessages:
        """Starts a server-streaming call, which ends without an error once `closed` is set."""
        await self._ready()
        try:
            call = self._method("unary_stream", name)(request, metadata=self._trust.metadata)
            return AsyncMessages(call, closed)
        except grpc.aio.UsageError as error:
            self._raise_if_closed(error)
            raise

    async def close(self) -> None:
        if self._channel is not None:
            await self._channel.close(None)


class SyncChannel(_Channel):
    """A channel to a server. Calls raise `Closed` once `closed` is set."""

    def __init__(self, trust: Trust, closed: SyncEvent) -> None:
        self._trust = trust
        self._closed = closed
        self._lock = threading.Lock()
        self._channel = None if trust.fingerprint else self._create(None)

    def _create(self, pinned: Pinned | None) -> Any:
        return self._trust.channel(grpc.insecure_channel, grpc.secure_channel, pinned)

    def _ready(self) -> None:
        """Creates the channel, if that has to wait for the server's certificate."""
        if self._channel is None:
            pinned = self._trust.fetch()
            with self._lock:
                self._raise_if_closed(None)
                self._channel = self._channel or self._create(pinned)

    def unary(self, name: str, request: Any, timeout_s: float) -> Any:
        """The response to a call. Raises `grpc.RpcError`."""
        try:
            self._ready()
            method = self._method("unary_unary", name)
            return method(request, timeout=timeout_s, metadata=self._trust.metadata)
        # grpc raises ValueError for a closed channel.
        except (grpc.RpcError, ValueError) as error:
            self._raise_if_closed(error)
            raise

    def stream(self, name: str, request: Any, closed: SyncEvent) -> SyncMessages:
        """Starts a server-streaming call."""
        self._ready()
        try:
            return SyncMessages(self._method("unary_stream", name)(request, metadata=self._trust.metadata))
        except ValueError as error:
            self._raise_if_closed(error)
            raise

    def close(self) -> None:
        with self._lock:
            channel = self._channel
        if channel is not None:
            channel.close()


def is_cancelled() -> bool:
    """Whether the running task has been asked to end; always False before Python 3.11, which does not count requests."""
    task = asyncio.current_task()
    return task is not None and hasattr(task, "cancelling") and task.cancelling() > 0
