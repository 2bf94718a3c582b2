"""State of a connection, timeouts, and closing of clients and streams, with and without a server."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from typing import Callable, Iterator

import grpc
import pytest
from conftest import Server
from test_client import TIMEOUT_S, run

from roundel import (
    Client,
    Closed,
    Disconnected,
    LinkState,
    NotRoundel,
    Reconnected,
    Refused,
    Snapshot,
    Stale,
    Subscription,
    TimedOut,
    Unreachable,
    _backoff,
    aio,
    v1,
)
from roundel._stream_state import StreamState

UNUSED_PORT = "http://127.0.0.1:9"
SILENT = Subscription(ids=[10**9], max_rate_hz=0.01)
"""A subscription whose second snapshot follows after a hundred seconds."""


@pytest.fixture
def long_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes every backoff longer than a test."""
    monkeypatch.setattr(_backoff, "INITIAL_S", 1e4)
    monkeypatch.setattr(_backoff, "MAX_S", 1e4)


@pytest.fixture
def silent() -> Iterator[str]:
    """Address of a socket that accepts connections and sends nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"


@contextlib.contextmanager
def proxy(address: str) -> Iterator[None]:
    """Answers at `address` like a proxy whose upstream server is down."""

    def answer() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                with connection:
                    connection.recv(4096)
                    connection.sendall(b"HTTP/1.1 502 Bad Gateway\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")

    host, port = address.split(":")
    with socket.create_server((host, int(port))) as listener:
        answering = threading.Thread(target=answer, daemon=True)
        answering.start()
        yield
        listener.shutdown(socket.SHUT_RDWR)
        answering.join()


def run_in_thread(function: Callable[[], object]) -> object:
    """The result of `function`; fails if it does not return."""
    found: list[object] = []
    thread = threading.Thread(target=lambda: found.append(function()), daemon=True)
    thread.start()
    thread.join(TIMEOUT_S)
    assert found, "it hangs"
    return found[0]


def test_latest_reports_that_its_snapshot_is_stale(own_server: list[Server]) -> None:
    own_server.append(Server())
    address = own_server[0].address
    with Client(own_server[0].url) as client, client.latest() as latest:
        first = latest.next(TIMEOUT_S)
        assert latest.link.is_up and latest.link.error is None
        assert latest.recent(TIMEOUT_S).sequence >= first.sequence and latest.age_s < TIMEOUT_S
        own_server[0].kill()
        with pytest.raises(Stale) as stale:
            for _ in range(1000):
                latest.next(timeout_s=0.5)
        assert isinstance(stale.value, TimeoutError) and stale.value.age_s >= 0.5
        while latest.link.state is not LinkState.LOST or latest.link.tries == 0:
            assert latest.age_s < TIMEOUT_S
        lost = latest.link
        assert isinstance(lost.error, Unreachable) and lost.tries > 0 and lost.losses == 1
        assert latest.value is not None and latest.value.sequence >= first.sequence
        with pytest.raises(Stale, match="the connection is lost: no answer from"):
            latest.recent(latest.age_s / 2.0)
        own_server.append(Server(address))
        latest.next(TIMEOUT_S)
        back = latest.link
        assert back.is_up and back.losses == 1 and back.restarts == 1 and isinstance(back.error, Unreachable)
        assert latest.recent(TIMEOUT_S).source_id != first.source_id


def test_latest_reports_that_its_snapshot_is_stale_with_asyncio(own_server: list[Server]) -> None:
    async def session() -> None:
        own_server.append(await asyncio.to_thread(Server))
        async with aio.Client(own_server[0].url) as client, client.latest() as latest:
            first = await latest.next(TIMEOUT_S)
            assert latest.link.is_up and latest.recent(TIMEOUT_S).sequence >= first.sequence
            own_server[0].kill()
            with pytest.raises(Stale, match="the newest arrived"):
                for _ in range(1000):
                    await latest.next(timeout_s=0.5)
            while latest.link.state is not LinkState.LOST:
                await asyncio.sleep(0.05)
            assert isinstance(latest.link.error, Unreachable) and latest.link.losses == 1
            with pytest.raises(Stale):
                latest.recent(latest.age_s / 2.0)
            own_server.append(await asyncio.to_thread(Server, own_server[0].address))
            assert (await latest.next(TIMEOUT_S)).source_id != first.source_id
            assert latest.link.is_up

    run(session())


def test_a_proxy_that_answers_for_a_restarting_server_does_not_end_the_stream(own_server: list[Server]) -> None:
    own_server.append(Server())
    url, address = own_server[0].url, own_server[0].address
    with Client(url) as client, client.updates() as updates:
        assert isinstance(next(updates), Snapshot)
        own_server[0].kill()
        with proxy(address):
            while "HTTP/2" not in reason(next(updates)):
                pass
            assert updates.link.state is LinkState.LOST
            with Client(url) as other, pytest.raises(NotRoundel, match="does not speak HTTP/2"):
                next(other.updates())
        own_server.append(Server(address))
        while not isinstance(next(updates), Reconnected):
            pass


def test_a_proxy_does_not_end_the_stream_with_asyncio(own_server: list[Server]) -> None:
    async def session() -> None:
        own_server.append(await asyncio.to_thread(Server))
        url, address = own_server[0].url, own_server[0].address
        async with aio.Client(url) as client, client.updates() as updates:
            assert isinstance(await anext(updates), Snapshot)
            own_server[0].kill()
            with proxy(address):
                while "HTTP/2" not in reason(await anext(updates)):
                    pass
                async with aio.Client(url) as other:
                    with pytest.raises(NotRoundel, match="does not speak HTTP/2"):
                        await anext(other.updates())
            own_server.append(await asyncio.to_thread(Server, address))
            while not isinstance(await anext(updates), Reconnected):
                pass

    run(session())


def reason(update: object) -> str:
    return update.reason if isinstance(update, Disconnected) else ""


def test_an_unexpected_error_of_the_reader_reaches_callers(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(state: StreamState, message: v1.Snapshot) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(StreamState, "received", fails)
    with Client(server.url) as client, client.latest() as latest:
        for _ in range(2):
            with pytest.raises(ZeroDivisionError, match="a bug"):
                latest.next(TIMEOUT_S)

    async def session() -> None:
        async with aio.Client(server.url) as client, client.latest() as latest:
            with pytest.raises(ZeroDivisionError, match="a bug"):
                await latest.next(TIMEOUT_S)

    run(session())


def test_close_ends_the_backoff_at_once(long_pauses: None) -> None:
    with Client(UNUSED_PORT) as client:
        for close in ("the stream", "the client"):
            updates = client.updates()
            assert isinstance(next(updates), Disconnected)
            threading.Timer(0.2, updates.close if close == "the stream" else client.close).start()
            assert run_in_thread(lambda: list(updates)) == [], close
            assert updates.link.state is LinkState.ENDED
        with pytest.raises(Closed, match="this client has been closed"):
            client.updates()


def test_close_ends_the_backoff_at_once_with_asyncio(long_pauses: None) -> None:
    async def session(closing: str) -> None:
        async with aio.Client(UNUSED_PORT) as client, client.updates() as updates:
            assert isinstance(await anext(updates), Disconnected)
            waiting = asyncio.create_task(rest(updates))
            await asyncio.sleep(0.1)
            if closing == "the stream":
                updates.close()
            else:
                await client.close()
            assert await waiting == []

    for closing in ("the stream", "the client"):
        run(session(closing))


async def rest(updates: aio.Snapshots) -> list[object]:
    return [update async for update in updates]


def test_closed_clients_and_streams_raise_closed(server: Server) -> None:
    client = Client(server.url)
    latest, waiting = client.latest(SILENT), client.latest(SILENT)
    latest.next(TIMEOUT_S)
    waiting.next(TIMEOUT_S)
    updates, events = client.updates(), client.events(backlog=1)
    next(updates), next(events)
    latest.close()
    for method in (latest.next, lambda: latest.recent(1e6)):
        with pytest.raises(Closed, match="this stream of snapshots has been closed"):
            method()
    assert list(latest) == []
    # Closes the client while another thread waits for the next snapshot.
    threading.Timer(0.2, client.close).start()
    assert run_in_thread(lambda: list(waiting)) == []
    assert run_in_thread(lambda: list(updates)) == [] and run_in_thread(lambda: list(updates)) == []
    assert not any(isinstance(event, Exception) for event in events)
    for call in (client.info, client.snapshot, client.latest, lambda: next(client.events())):
        with pytest.raises(Closed):
            call()
    client.close()


def test_closed_clients_and_streams_raise_closed_with_asyncio(server: Server) -> None:
    async def session() -> None:
        client = aio.Client(server.url)
        latest, waiting = client.latest(), client.latest(SILENT)
        await latest.next(TIMEOUT_S)
        await waiting.next(TIMEOUT_S)
        await latest.close()
        for method in (latest.next, lambda: asyncio.to_thread(latest.recent, 1e6)):
            with pytest.raises(Closed):
                await method()
        assert [one async for one in latest] == []
        tasks = [asyncio.create_task(rest(client.updates(SILENT))), asyncio.create_task(all_of(waiting))]
        tasks.append(asyncio.create_task(all_of(client.events())))
        await asyncio.sleep(0.3)
        await client.close()
        seen = await asyncio.gather(*tasks)
        assert all(isinstance(one, Snapshot) for one in seen[0]) and seen[1] == []
        for call in (client.info, client.snapshot):
            with pytest.raises(Closed):
                await call()
        with pytest.raises(Closed):
            client.latest()
        await client.close()

    run(session())


async def all_of(stream: object) -> list[object]:
    return [one async for one in stream]  # type: ignore[attr-defined]


def test_cancelling_a_task_does_not_close_the_stream(server: Server) -> None:
    async def session() -> None:
        async with aio.Client(server.url) as client, client.latest(SILENT) as latest:
            await latest.next(TIMEOUT_S)
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(rest(client.updates(SILENT)), 0.3)
            with pytest.raises(Stale):
                await latest.next(0.1)
            assert latest.link.is_up

    run(session())


def test_calls_to_a_silent_server_time_out(silent: str) -> None:
    with Client(silent, timeout_s=0.3) as client:
        with pytest.raises(TimedOut, match=f"no answer from {silent}: GetServerInfo took longer than .* 0.3 s") as late:
            client.info()
        assert late.value.is_temporary and isinstance(late.value, TimeoutError)
        with pytest.raises(TimedOut, match="0.2 s"):
            client.within(0.2).drive({1: [0.0, 0.0]})
    with pytest.raises(TimedOut):
        Client.connect(silent, timeout_s=0.3)

    async def session() -> None:
        async with aio.Client(silent, timeout_s=0.3) as client:
            with pytest.raises(TimedOut, match="0.3 s"):
                await client.info()
            with pytest.raises(TimedOut, match="0.2 s"):
                await client.within(0.2).snapshot()

    run(session())


def test_a_refusal_names_the_field_or_the_resource(server: Server) -> None:
    with Client.connect(server.url) as client:
        with pytest.raises(Refused) as wrong:
            next(client.snapshots(Subscription(max_rate_hz=-1.0)))
        assert (wrong.value.code, wrong.value.field) == (grpc.StatusCode.INVALID_ARGUMENT, "max_rate_hz")
        with pytest.raises(Refused) as missing:
            client.camera_setup("camera-9")
        assert (missing.value.code, missing.value.what) == (grpc.StatusCode.NOT_FOUND, "camera")
        assert missing.value.field is None
        with pytest.raises(Refused) as refused:
            client.control_replay(paused=True)
        assert refused.value.code is grpc.StatusCode.FAILED_PRECONDITION

    async def session() -> None:
        async with await aio.Client.connect(server.url) as client:
            with pytest.raises(Refused) as wrong:
                await client.drive({10**6: [3.0, 0.0]})
            assert wrong.value.field == "robots[0].velocity"
            with pytest.raises(Refused) as again:
                await client.change_camera("camera-9", v1.CameraSetup(), ["source"])
            assert again.value.what == "camera"

    run(session())
