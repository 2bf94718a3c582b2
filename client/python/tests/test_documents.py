"""Runs the Python code blocks of the documents against a real server."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Iterator

import pytest
from conftest import ROOT, Server
from test_client import TIMEOUT_S, wait_until, wait_until_all_tracked

from roundel import Client, Subscription

PACKAGE = Path(__file__).resolve().parents[1]
DOCUMENTS = [path for path in (PACKAGE / "README.md", ROOT / "client/README.md", ROOT / "README.md") if path.is_file()]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ADDRESS = "http://127.0.0.1:7670"
CART = "cart"
"""Name of the robot in the documents."""
POSITION = re.compile(r"\[( *-?[\d.]+(e[+-]?\d+)?){3} *\]")
"""Three numbers as printed by NumPy."""


def blocks() -> list[object]:
    """Every Python block, identified by document and index."""
    found = []
    for document in DOCUMENTS:
        name = document.relative_to(PACKAGE.parent if document.is_relative_to(PACKAGE.parent) else document.parent)
        for index, code in enumerate(BLOCK.findall(document.read_text(encoding="utf-8"))):
            found.append(pytest.param(code, id=f"{name}-{index}"))
    return found


@pytest.fixture(scope="module")
def server_with_cart() -> Iterator[Server]:
    """A server with coded robots, one of which has the name used in the documents."""
    running = Server("127.0.0.1:0", "--preset", "r4")
    try:
        with Client.connect(running.url) as client:
            parked = {None, *(reference.code for reference in client.configuration().references)}
            seen = wait_until(client, Subscription(), lambda snapshot: bool(set(snapshot.codes) - parked))
            robot = next(seen[row] for row, code in enumerate(seen.codes) if code not in parked)
            client.name_object(robot.object_id, CART)
        yield running
    finally:
        running.kill()


def test_blocks_are_found() -> None:
    assert len(blocks()) >= 2


@pytest.mark.parametrize("code", blocks())
def test_a_block_runs(code: str, request: pytest.FixtureRequest, own_server: list[Server]) -> None:
    assert ADDRESS in code
    follows = f'"{CART}"' in code
    if follows:
        server: Server = request.getfixturevalue("server_with_cart")
    else:
        # A block may drive the robots, even out of the cameras' view.
        server = Server()
        own_server.append(server)
        with Client.connect(server.url) as client:
            wait_until_all_tracked(client)
    command = [sys.executable, "-u", "-W", "error", "-c", code.replace(ADDRESS, server.url)]
    if not follows:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S)
        assert ended.returncode == 0, ended.stderr
        return
    # It runs forever, so it is killed after the first position.
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None and running.stderr is not None
        timer = threading.Timer(TIMEOUT_S, running.kill)
        timer.start()
        position = next((line for line in running.stdout if POSITION.match(line)), None)
        timer.cancel()
        running.kill()
        assert position is not None, running.stderr.read()
