"""Credentials and roles on a real server: typed errors of both clients, and statuses of REST and WebSocket."""

from __future__ import annotations

import asyncio
import base64
import http.client
import json
import os
import socket
import subprocess
from pathlib import Path
from typing import Any, AsyncIterator, Callable, Iterator

import pytest
from conftest import ConfiguredServer, binary
from test_client import TIMEOUT_S
from test_link import run_in_thread

from roundel import Client, LinkState, PermissionDenied, RoundelError, Subscription, Unauthenticated, aio, v1

CONFIG = """
name = "lab"
[server]
listen = "127.0.0.1:0"
[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0
[[camera]]
name = "north"
source = "sim:?robots=1"
"""
WRONG = {"missing": None, "wrong": "guessed", "expired": "former"}
"""Credentials that the server does not accept: None, a token, or the name of a user."""
STREAMS: dict[str, Callable[[Any], Any]] = {
    "updates": lambda client: client.updates(),
    "snapshots": lambda client: client.snapshots(),
    "selected snapshots": lambda client: client.snapshots(Subscription(ids=[1], max_rate_hz=1.0)),
    "events": lambda client: client.events(backlog=10),
    "observations": lambda client: client.observations(),
    "calibration": lambda client: client.watch_calibration(),
}
VIEWED: dict[str, Callable[[Any], Any]] = {
    "snapshot": lambda client: client.snapshot(),
    "objects": lambda client: client.objects(),
    "cameras": lambda client: client.cameras(),
    "picture": lambda client: client.picture("north"),
    "newest_observations": lambda client: client.newest_observations(),
    "history": lambda client: client.history(),
    "recordings": lambda client: client.recordings(),
}
OPERATED: dict[str, Callable[[Any], Any]] = {
    "drive": lambda client: client.drive({1: (0.0, 0.0, 0.0)}),
    "push": lambda client: client.push(1, (0.0, 0.0, 0.0), 0.1),
    "start_recording": lambda client: client.start_recording("trial"),
    "stop_recording": lambda client: client.stop_recording(),
    "start_calibration": lambda client: client.start_calibration(),
    "cancel_calibration": lambda client: client.cancel_calibration(),
}
SET_UP: dict[str, Callable[[Any], Any]] = {
    "configuration": lambda client: client.configuration(),
    "check_configuration": lambda client: client.check_configuration(CONFIG),
    "apply_configuration": lambda client: client.apply_configuration(CONFIG),
    "add_camera": lambda client: client.add_camera(v1.CameraSetup(name="south", source="sim:")),
    "remove_camera": lambda client: client.remove_camera("north"),
    "name_object": lambda client: client.name_object(1, "cart"),
    "test_source": lambda client: client.test_source("sim:"),
}


class AccessServer(ConfiguredServer):
    """A running `roundel serve` with the users viewer, node, operator, admin, and former, who has expired."""

    def __init__(self, folder: Path) -> None:
        self.config = folder / "lab.toml"
        self.config.write_text(CONFIG)
        roles = {"viewer": "view", "operator": "operate", "admin": "setup"}
        self.tokens = {name: self._add(name, "--role", role) for name, role in roles.items()}
        self.tokens["node"] = self._add("node", "--role", "feed", "--cameras", "north")
        self.tokens["former"] = self._add("former", "--role", "setup", "--expires", "2099-01-01")
        text = self.config.read_text()
        assert text.count("2099-01-01") == 1, text
        self.config.write_text(text.replace("2099-01-01", "2020-01-01"))
        self.text = self.config.read_text()
        super().__init__(self.config)
        self.address = self.url.removeprefix("http://")

    def _add(self, name: str, *options: str) -> str:
        command = [str(binary()), "token", "add", name, *options, "--config", str(self.config)]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def token(self, name: str | None) -> str | None:
        """The token of a user; another text is a token itself."""
        return None if name is None else self.tokens.get(name, name)

    def get(self, path: str, token: str | None, method: str = "GET", **headers: str) -> tuple[int, Any, Any]:
        """Status, headers, and body as JSON if it is an error."""
        connection = http.client.HTTPConnection(self.address, timeout=TIMEOUT_S)
        try:
            if token is not None:
                headers["authorization"] = f"Bearer {token}"
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            body = None if answer.status < 400 else json.loads(answer.read())
            return answer.status, answer.headers, body
        finally:
            connection.close()

    def upgrade(self, token: str | None) -> tuple[int, bytes]:
        """Status of the handshake of a WebSocket, and what follows it: a message, or the body of an error."""
        host, port = self.address.split(":")
        key = base64.b64encode(os.urandom(16)).decode()
        lines = [
            "GET /api/v1/stream HTTP/1.1",
            f"host: {self.address}",
            "connection: upgrade",
            "upgrade: websocket",
            "sec-websocket-version: 13",
            f"sec-websocket-key: {key}",
            *([] if token is None else [f"authorization: Bearer {token}"]),
        ]
        with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as connection:
            connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
            received = b""
            while b"\r\n\r\n" not in received or not received.split(b"\r\n\r\n", 1)[1]:
                part = connection.recv(65536)
                assert part, received
                received += part
            head, rest = received.split(b"\r\n\r\n", 1)
            return int(head.split()[1]), rest


@pytest.fixture(scope="module")
def access(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AccessServer]:
    running = AccessServer(tmp_path_factory.mktemp("access"))
    yield running
    running.stop()


def error_of(server: AccessServer, name: str | None, call: Callable[[Any], Any], is_stream: bool = False) -> RoundelError:
    """The error of a call of the blocking client. A stream raises it as its first item, and has ended then."""

    def attempt() -> RoundelError:
        with Client(server.url, token=server.token(name)) as client:
            with pytest.raises(RoundelError) as caught:
                next(iter(call(client))) if is_stream else call(client)
        return caught.value

    error = run_in_thread(attempt)
    assert isinstance(error, RoundelError)
    return error


def async_error_of(
    server: AccessServer, name: str | None, call: Callable[[Any], Any], is_stream: bool = False
) -> RoundelError:
    """As `error_of`, of the asyncio client."""

    async def attempt() -> RoundelError:
        async with aio.Client(server.url, token=server.token(name)) as client:
            with pytest.raises(RoundelError) as caught:
                if is_stream:
                    items: AsyncIterator[Any] = call(client).__aiter__()
                    await asyncio.wait_for(items.__anext__(), TIMEOUT_S)
                else:
                    await asyncio.wait_for(call(client), TIMEOUT_S)
            return caught.value

    return asyncio.run(attempt())


ERRORS = pytest.mark.parametrize("error_of", [error_of, async_error_of], ids=["blocking", "asyncio"])


@ERRORS
@pytest.mark.parametrize("name", WRONG.values(), ids=WRONG)
def test_credentials_that_are_not_accepted_are_unauthenticated(
    access: AccessServer, error_of: Callable[..., RoundelError], name: str | None
) -> None:
    said = {None: "needs credentials", "guessed": "not one of this server", "former": '"former" have expired'}[name]
    calls = {"info": lambda client: client.info(), **VIEWED, **OPERATED, **SET_UP}
    for what, call, is_stream in [*((*it, False) for it in calls.items()), *((*it, True) for it in STREAMS.items())]:
        error = error_of(access, name, call, is_stream)
        assert type(error) is Unauthenticated, f"{what}: {error!r}"
        assert said in error.message and not error.is_temporary, f"{what}: {error}"


@ERRORS
def test_a_role_that_does_not_permit_a_call_is_permission_denied(
    access: AccessServer, error_of: Callable[..., RoundelError]
) -> None:
    calls = {
        "view": ["node"],
        "operate": ["node", "viewer"],
        "setup": ["node", "viewer", "operator"],
    }
    listed = {"view": VIEWED, "operate": OPERATED, "setup": SET_UP}
    cases = [(role, name, *it, False) for role, names in calls.items() for name in names for it in listed[role].items()]
    cases += [("view", "node", *it, True) for it in STREAMS.items()]
    for role, name, what, call, is_stream in cases:
        error = error_of(access, name, call, is_stream)
        assert type(error) is PermissionDenied, f"{what} as {name}: {error!r}"
        assert f'needs the role "{role}", and "{name}"' in error.message, f"{what}: {error}"
        assert not error.is_temporary
    assert access.config.read_text() == access.text


def test_roles_that_permit_a_call_are_not_refused(access: AccessServer) -> None:
    for name in ("viewer", "operator", "admin"):
        with Client.connect(access.url, token=access.token(name)) as client:
            for what, call in STREAMS.items():
                if what != "events" and what != "selected snapshots":
                    assert next(iter(call(client))) is not None, what
            assert client.cameras()[0].name == "north"
    with Client.connect(access.url, token=access.token("admin")) as client:
        assert client.configuration().toml
    # A node may ask which server it feeds.
    with Client.connect(access.url, token=access.token("node")) as client:
        assert client.info().name == "lab"


@pytest.mark.parametrize("name", ["guessed", "node"])
def test_the_newest_snapshot_ends_with_the_error(access: AccessServer, name: str) -> None:
    expected = PermissionDenied if name == "node" else Unauthenticated

    def blocking() -> None:
        with Client(access.url, token=access.token(name)) as client, client.latest() as latest:
            for _ in range(2):
                with pytest.raises(expected):
                    latest.next(timeout_s=TIMEOUT_S)
            with pytest.raises(expected):
                latest.recent(1e9)
            assert latest.link.state is LinkState.ENDED

    async def asynchronous() -> None:
        async with aio.Client(access.url, token=access.token(name)) as client:
            latest = client.latest()
            for _ in range(2):
                with pytest.raises(expected):
                    await latest.next(timeout_s=TIMEOUT_S)
            await latest.close()

    run_in_thread(blocking)
    asyncio.run(asynchronous())


@pytest.mark.parametrize("name", ["guessed", "node"])
def test_a_stream_is_not_opened_again(access: AccessServer, name: str) -> None:
    with Client(access.url, token=access.token(name)) as client:
        for stream in (client.updates(), client.snapshots(), client.events()):
            with pytest.raises((Unauthenticated, PermissionDenied)):
                next(stream)
            assert list(stream) == []


@pytest.mark.parametrize(
    ("name", "status", "code"),
    [
        (None, 401, "unauthenticated"),
        ("guessed", 401, "unauthenticated"),
        ("former", 401, "unauthenticated"),
        ("node", 403, "permission_denied"),
    ],
)
def test_rest_and_websocket_refuse_with_a_status(access: AccessServer, name: str | None, status: int, code: str) -> None:
    token = access.token(name)
    for path in ("/api/v1/snapshot", "/api/v1/cameras", "/api/v1/cameras/north/frame.jpg", "/metrics"):
        found, headers, body = access.get(path, token)
        assert (found, body["error"]["code"]) == (status, code), path
        assert headers["www-authenticate"] == ("Bearer" if status == 401 else None)
    found, message = access.upgrade(token)
    assert (found, json.loads(message)["error"]["code"]) == (status, code)


def test_rest_and_websocket_permit_the_role(access: AccessServer) -> None:
    viewer, operator = access.token("viewer"), access.token("operator")
    assert access.get("/api/v1/cameras", viewer)[0] == 200
    assert access.upgrade(viewer)[0] == 101
    status, _, body = access.get("/api/v1/recording", viewer, method="DELETE")
    assert (status, body["error"]["code"]) == (403, "permission_denied")
    # Permitted, but nothing is being recorded.
    assert access.get("/api/v1/recording", operator, method="DELETE")[0] == 409
    assert access.get("/api/v1/configuration", operator)[0] == 403
    # Other schemes than Bearer.
    basic = base64.b64encode(f"viewer:{viewer}".encode()).decode()
    assert access.get("/api/v1/cameras", None, authorization=f"Basic {basic}")[0] == 401
    assert access.get(f"/api/v1/cameras?token={viewer}", None)[0] == 401
