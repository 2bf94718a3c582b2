"""The Python of the documents runs as it stands there, against a real server."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Iterator

import pytest
from conftest import ROOT, Server
from test_client import PATIENCE_S, until, until_all_are_there

from roundel import Client, Subscription

PACKAGE = Path(__file__).resolve().parents[1]
DOCUMENTS = [path for path in (PACKAGE / "README.md", ROOT / "client/README.md", ROOT / "README.md") if path.is_file()]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ADDRESS = "http://127.0.0.1:7670"
CART = "cart"
"""Who is followed by name in the documents."""
POSITION = re.compile(r"\[( *-?[\d.]+(e[+-]?\d+)?){3} *\]")
"""As NumPy prints three numbers."""


def blocks() -> list[object]:
    """Every block of Python, under its document's name and its place in it."""
    found = []
    for document in DOCUMENTS:
        name = document.relative_to(PACKAGE.parent if document.is_relative_to(PACKAGE.parent) else document.parent)
        for place, code in enumerate(BLOCK.findall(document.read_text(encoding="utf-8"))):
            found.append(pytest.param(code, id=f"{name}-{place}"))
    return found


@pytest.fixture(scope="module")
def server_with_cart() -> Iterator[Server]:
    """One of coded robots, which can be told apart: one of them has the name that the documents follow."""
    running = Server("127.0.0.1:0", "--preset", "r4")
    try:
        with Client.connect(running.url) as client:
            parked = {None, *(reference.code for reference in client.configuration().references)}
            seen = until(client, Subscription(), lambda snapshot: bool(set(snapshot.codes) - parked))
            robot = next(seen[row] for row, code in enumerate(seen.codes) if code not in parked)
            client.name_object(robot.object_id, CART)
        yield running
    finally:
        running.kill()


def test_there_are_blocks_to_try() -> None:
    assert len(blocks()) >= 2


@pytest.mark.parametrize("code", blocks())
def test_a_block_runs_as_it_stands(code: str, request: pytest.FixtureRequest) -> None:
    assert ADDRESS in code
    follows = f'"{CART}"' in code
    server: Server = request.getfixturevalue("server_with_cart" if follows else "server")
    if not follows:
        with Client.connect(server.url) as client:
            until_all_are_there(client)
    command = [sys.executable, "-u", "-W", "error", "-c", code.replace(ADDRESS, server.url)]
    if not follows:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
        assert ended.returncode == 0, ended.stderr
        return
    # It follows for ever, and is ended once it has said where the robot is.
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None and running.stderr is not None
        late = threading.Timer(PATIENCE_S, running.kill)
        late.start()
        said = next((line for line in running.stdout if POSITION.match(line)), None)
        late.cancel()
        running.kill()
        assert said is not None, running.stderr.read()
