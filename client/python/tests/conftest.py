"""A real server for the tests: `roundel demo` on a free port."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from typing import Iterator

import pytest

ROBOTS = 12
ROOT = Path(__file__).resolve().parents[3]


def binary() -> Path:
    """The server binary: ROUNDEL_BINARY, or the output of `cargo build`."""
    given = os.environ.get("ROUNDEL_BINARY")
    candidates = [Path(given)] if given else [ROOT / "target/debug/roundel", ROOT / "target/release/roundel"]
    found = next((path for path in candidates if path.is_file()), None)
    if found is None:
        pytest.fail(f"expected a server binary at one of {[str(c) for c in candidates]}: cargo build, or ROUNDEL_BINARY=…")
    return found


class Server:
    """A running `roundel demo`."""

    def __init__(self, listen: str = "127.0.0.1:0", *options: str, folder: Path | None = None) -> None:
        command = [str(binary()), "demo", "--listen", listen, "--robots", str(ROBOTS), *options]
        self.process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert self.process.stdout is not None
        output = []
        for line in self.process.stdout:
            output.append(line)
            found = re.search(r"listening on http://(\S+?)/?\s", line)
            if found:
                self.address = found[1]
                self.url = f"http://{self.address}"
                break
        else:
            pytest.fail(f"the server ended before it listened:\n{''.join(output)}")
        # The rest is not read. A full pipe only blocks the log of the server.

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()


class ConfiguredServer:
    """A running `roundel serve`."""

    def __init__(self, config: Path) -> None:
        command = [str(binary()), "serve", "--config", str(config)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert self.process.stdout is not None
        self.output = ""
        """What it printed until it listened."""
        for line in self.process.stdout:
            self.output += line
            if line.startswith("listening on "):
                self.url = line.removeprefix("listening on ").strip()
                return
        self.stop()
        pytest.fail(f"the server ended before it listened:\n{self.output}")

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    """One server, shared by the tests that do not stop it."""
    running = Server()
    yield running
    running.kill()


@pytest.fixture
def own_server() -> Iterator[list[Server]]:
    """Collects the servers that a test starts, and stops them after it."""
    servers: list[Server] = []
    yield servers
    for running in servers:
        running.kill()
