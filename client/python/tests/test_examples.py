"""The examples, run as their users run them."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
from conftest import ROBOTS, Server
from test_client import until_all_are_there

from roundel import Client

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PATIENCE_S = 180.0


def run(example: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLES / example), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)


def test_robots_form_a_circle_and_keep_it_while_one_is_pushed_away(own_server: list[Server]) -> None:
    own_server.append(Server())
    url, radius_m = own_server[0].url, 1.8
    with Client.connect(url) as client:
        until_all_are_there(client)
        ended = run("formation.py", "--server", url, "--radius", str(radius_m))
        assert ended.returncode == 0, ended.stdout + ended.stderr
        assert "pushing robot" in ended.stdout
        # Robots that hear nothing stop, so they stand where the example left them: judged by itself, whatever it says.
        snapshot = client.snapshot()
        at_m = snapshot.positions_m[:, :2]
        assert len(at_m) == ROBOTS
        angles = np.sort(np.arctan2(at_m[:, 1], at_m[:, 0]))
        places = radius_m * np.stack([np.cos(np.arange(ROBOTS) * np.pi / 6), np.sin(np.arange(ROBOTS) * np.pi / 6)], 1)
        off_m = np.linalg.norm(at_m[:, None] - places[None], axis=-1).min(axis=1)
        assert np.sqrt((off_m**2).mean()) <= 0.03, off_m
        np.testing.assert_allclose(np.diff(angles), np.pi / 6, atol=0.06)


def test_too_few_robots_are_told(server: Server) -> None:
    script = (EXAMPLES / "formation.py").read_text().replace("PATIENCE_S = 60.0", "PATIENCE_S = 3.0")
    command = [sys.executable, "-c", script, "--server", server.url, "--robots", str(ROBOTS + 1)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert ended.returncode == 1
    assert f"expected {ROBOTS + 1} robots to be seen, found {ROBOTS}" in ended.stderr


def test_a_recording_has_a_line_for_each_robot_of_each_snapshot(server: Server, tmp_path: Path) -> None:
    with Client.connect(server.url) as client:
        until_all_are_there(client)
    file = tmp_path / "run.csv"
    ended = run("record.py", str(file), "--server", server.url, "--seconds", "1", "--rate", "20")
    assert ended.returncode == 0, ended.stderr
    with file.open(newline="") as text:
        lines = list(csv.DictReader(text))
    sequences = [int(line["sequence"]) for line in lines]
    assert len(lines) == ROBOTS * len(set(sequences))
    assert f"{len(set(sequences))} snapshots written" in ended.stderr
    assert sequences == sorted(sequences)
    for line in lines:
        assert abs(np.linalg.norm([float(line[key]) for key in ("qx", "qy", "qz", "qw")]) - 1.0) < 1e-5
        assert 0.0 < float(line["sx_m"]) < 0.1


def test_one_robot_is_followed(server: Server) -> None:
    with Client.connect(server.url) as client:
        object_id = int(until_all_are_there(client).ids[0])
    command = [sys.executable, str(EXAMPLES / "follow.py"), str(object_id), server.url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as following:
        assert following.stdout is not None
        lines = [following.stdout.readline() for _ in range(3)]
        following.kill()
    assert all("m/s  sigma" in line and ("seen" in line or "predicted" in line) for line in lines)
    ended = run("follow.py", "nobody", server.url)
    assert ended.returncode == 1 and "no robot has the name or code 'nobody'" in ended.stderr
