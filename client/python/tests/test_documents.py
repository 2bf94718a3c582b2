"""The Python of the documents runs as it stands there, against a real server."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, Server
from test_client import PATIENCE_S, until_all_are_there

from roundel import Client

PACKAGE = Path(__file__).resolve().parents[1]
DOCUMENTS = [path for path in (PACKAGE / "README.md", ROOT / "client/README.md", ROOT / "README.md") if path.is_file()]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ADDRESS = "http://127.0.0.1:7670"


def blocks() -> list[object]:
    """Every block of Python, under its document's name and its place in it."""
    found = []
    for document in DOCUMENTS:
        name = document.relative_to(PACKAGE.parent if document.is_relative_to(PACKAGE.parent) else document.parent)
        for place, code in enumerate(BLOCK.findall(document.read_text(encoding="utf-8"))):
            found.append(pytest.param(code, id=f"{name}-{place}"))
    return found


def test_there_are_blocks_to_try() -> None:
    assert len(blocks()) >= 2


@pytest.mark.parametrize("code", blocks())
def test_a_block_runs_as_it_stands(code: str, server: Server) -> None:
    with Client.connect(server.url) as client:
        until_all_are_there(client)
    assert ADDRESS in code
    # Sees its first lines and ends it, unless it ends by itself: most follow robots for ever.
    command = [sys.executable, "-u", "-W", "error", "-c", code.replace(ADDRESS, server.url)]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with running:
        assert running.stdout is not None
        if "print(" in code and "for _ in range" not in code:
            said = [running.stdout.readline() for _ in range(3)]
            running.kill()
            assert all(line.strip() for line in said), running.communicate()[1]
        else:
            _, complaint = running.communicate(timeout=PATIENCE_S)
            assert running.returncode == 0, complaint
