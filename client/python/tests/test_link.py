"""What a program can know of its connection, and how what is closed ends: against a real server, and against none."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from typing import Callable, Iterator

import grpc
import pytest
from conftest import Server
from test_client import PATIENCE_S, run

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

NOBODY = "http://127.0.0.1:9"
SEEN_BY_NONE = Subscription(ids=[10**9], max_rate_hz=0.01)
"""After its first snapshot there is nothing to get for a hundred seconds."""


@pytest.fixture
def long_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever waits for the next try waits for longer than any test."""
    monkeypatch.setattr(_backoff, "FIRST_S", 1e4)
    monkeypatch.setattr(_backoff, "LONGEST_S", 1e4)


@pytest.fixture
def silent() -> Iterator[str]:
    """Somebody who takes connections and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"


@contextlib.contextmanager
def proxy(address: str) -> Iterator[None]:
    """Somebody who answers there as a web server does whose own server is away."""

    def answer() -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = listener.accept()
                with near:
                    near.recv(4096)
                    near.sendall(b"HTTP/1.1 502 Bad Gateway\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")

    host, port = address.split(":")
    with socket.create_server((host, int(port))) as listener:
        answering = threading.Thread(target=answer, daemon=True)
        answering.start()
        yield
        listener.shutdown(socket.SHUT_RDWR)
        answering.join()


def ends(what: Callable[[], object]) -> object:
    """What `what` returns on a thread of its own, if it does."""
    found: list[object] = []
    thread = threading.Thread(target=lambda: found.append(what()), daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert found, "it hangs"
    return found[0]


def test_a_control_loop_hears_that_its_newest_value_grows_old(own_server: list[Server]) -> None:
    own_server.append(Server())
    address = own_server[0].address
    with Client(own_server[0].url) as client, client.latest() as latest:
        first = latest.next(PATIENCE_S)
        assert latest.link.is_up and latest.link.error is None
        assert latest.recent(PATIENCE_S).sequence >= first.sequence and latest.age_s < PATIENCE_S
        own_server[0].kill()
        with pytest.raises(Stale) as stale:
            for _ in range(1000):
                latest.next(timeout_s=0.5)
        assert isinstance(stale.value, TimeoutError) and stale.value.age_s >= 0.5
        while latest.link.state is not LinkState.LOST or latest.link.tries == 0:
            assert latest.age_s < PATIENCE_S
        lost = latest.link
        assert isinstance(lost.error, Unreachable) and lost.tries > 0 and lost.losses == 1
        assert latest.value is not None and latest.value.sequence >= first.sequence
        with pytest.raises(Stale, match="the connection is lost: no answer from"):
            latest.recent(latest.age_s / 2.0)
        own_server.append(Server(address))
        latest.next(PATIENCE_S)
        back = latest.link
        assert back.is_up and back.losses == 1 and back.restarts == 1 and isinstance(back.error, Unreachable)
        assert latest.recent(PATIENCE_S).source_id != first.source_id


def test_a_control_loop_of_asyncio_does_too(own_server: list[Server]) -> None:
    async def session() -> None:
        own_server.append(await asyncio.to_thread(Server))
        async with aio.Client(own_server[0].url) as client, client.latest() as latest:
            first = await latest.next(PATIENCE_S)
            assert latest.link.is_up and latest.recent(PATIENCE_S).sequence >= first.sequence
            own_server[0].kill()
            with pytest.raises(Stale, match="the newest came"):
                for _ in range(1000):
                    await latest.next(timeout_s=0.5)
            while latest.link.state is not LinkState.LOST:
                await asyncio.sleep(0.05)
            assert isinstance(latest.link.error, Unreachable) and latest.link.losses == 1
            with pytest.raises(Stale):
                latest.recent(latest.age_s / 2.0)
            own_server.append(await asyncio.to_thread(Server, own_server[0].address))
            assert (await latest.next(PATIENCE_S)).source_id != first.source_id
            assert latest.link.is_up

    run(session())


def test_a_proxy_that_answers_while_the_server_is_away_ends_nothing(own_server: list[Server]) -> None:
    own_server.append(Server())
    url, address = own_server[0].url, own_server[0].address
    with Client(url) as client, client.updates() as updates:
        assert isinstance(next(updates), Snapshot)
        own_server[0].kill()
        with proxy(address):
            while "HTTP/2" not in reason(next(updates)):
                pass
            assert updates.link.state is LinkState.LOST
            with Client(url) as other, pytest.raises(NotRoundel, match="speaks no HTTP/2"):
                next(other.updates())
        own_server.append(Server(address))
        while not isinstance(next(updates), Reconnected):
            pass


def test_a_proxy_ends_nothing_with_asyncio(own_server: list[Server]) -> None:
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
                    with pytest.raises(NotRoundel, match="speaks no HTTP/2"):
                        await anext(other.updates())
            own_server.append(await asyncio.to_thread(Server, address))
            while not isinstance(await anext(updates), Reconnected):
                pass

    run(session())


def reason(update: object) -> str:
    return update.reason if isinstance(update, Disconnected) else ""


def test_a_bug_while_reading_reaches_who_waits(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(follower: StreamState, message: v1.Snapshot) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(StreamState, "received", fails)
    with Client(server.url) as client, client.latest() as latest:
        for _ in range(2):
            with pytest.raises(ZeroDivisionError, match="a bug"):
                latest.next(PATIENCE_S)

    async def session() -> None:
        async with aio.Client(server.url) as client, client.latest() as latest:
            with pytest.raises(ZeroDivisionError, match="a bug"):
                await latest.next(PATIENCE_S)

    run(session())


def test_who_waits_for_the_next_try_is_let_go_at_once(long_pauses: None) -> None:
    with Client(NOBODY) as client:
        for close in ("the stream", "the client"):
            updates = client.updates()
            assert isinstance(next(updates), Disconnected)
            threading.Timer(0.2, updates.close if close == "the stream" else client.close).start()
            assert ends(lambda: list(updates)) == [], close
            assert updates.link.state is LinkState.ENDED
        with pytest.raises(Closed, match="this client has been closed"):
            client.updates()


def test_who_waits_for_the_next_try_with_asyncio_is_let_go_at_once(long_pauses: None) -> None:
    async def session(closing: str) -> None:
        async with aio.Client(NOBODY) as client, client.updates() as updates:
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


def test_what_is_closed_says_so(server: Server) -> None:
    client = Client(server.url)
    latest, waiting = client.latest(SEEN_BY_NONE), client.latest(SEEN_BY_NONE)
    latest.next(PATIENCE_S)
    waiting.next(PATIENCE_S)
    updates, events = client.updates(), client.events(backlog=1)
    next(updates), next(events)
    latest.close()
    for asked in (latest.next, lambda: latest.recent(1e6)):
        with pytest.raises(Closed, match="this stream of snapshots has been closed"):
            asked()
    assert list(latest) == []
    # Another thread waits for what will not come, while the client is closed.
    threading.Timer(0.2, client.close).start()
    assert ends(lambda: list(waiting)) == []
    assert ends(lambda: list(updates)) == [] and ends(lambda: list(updates)) == []
    assert not any(isinstance(event, Exception) for event in events)
    for call in (client.info, client.snapshot, client.latest, lambda: next(client.events())):
        with pytest.raises(Closed):
            call()
    client.close()


def test_what_is_closed_with_asyncio_says_so(server: Server) -> None:
    async def session() -> None:
        client = aio.Client(server.url)
        latest, waiting = client.latest(), client.latest(SEEN_BY_NONE)
        await latest.next(PATIENCE_S)
        await waiting.next(PATIENCE_S)
        await latest.close()
        for asked in (latest.next, lambda: asyncio.to_thread(latest.recent, 1e6)):
            with pytest.raises(Closed):
                await asked()
        assert [one async for one in latest] == []
        tasks = [asyncio.create_task(rest(client.updates(SEEN_BY_NONE))), asyncio.create_task(all_of(waiting))]
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


def test_a_cancelled_task_is_not_taken_for_a_closed_stream(server: Server) -> None:
    async def session() -> None:
        async with aio.Client(server.url) as client, client.latest(SEEN_BY_NONE) as latest:
            await latest.next(PATIENCE_S)
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(rest(client.updates(SEEN_BY_NONE)), 0.3)
            with pytest.raises(Stale):
                await latest.next(0.1)
            assert latest.link.is_up

    run(session())


def test_who_says_nothing_is_not_waited_for(silent: str) -> None:
    with Client(silent, timeout_s=0.3) as client:
        with pytest.raises(TimedOut, match=f"no answer from {silent}: GetServerInfo has taken longer than .* 0.3 s") as late:
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


def test_a_refusal_names_the_field_or_the_thing(server: Server) -> None:
    with Client.connect(server.url) as client:
        with pytest.raises(Refused) as wrong:
            next(client.snapshots(Subscription(max_rate_hz=-1.0)))
        assert (wrong.value.code, wrong.value.field) == (grpc.StatusCode.INVALID_ARGUMENT, "max_rate_hz")
        with pytest.raises(Refused) as nobody:
            client.camera_setup("camera-9")
        assert (nobody.value.code, nobody.value.what) == (grpc.StatusCode.NOT_FOUND, "camera")
        assert nobody.value.field is None
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
