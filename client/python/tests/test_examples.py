"""Runs the examples as scripts."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from conftest import ROBOTS, Server
from numpy.typing import NDArray
from test_client import wait_until_all_tracked

from roundel import Client, Snapshot

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
TIMEOUT_S = 180.0
TOLERANCE_M = 0.03
"""Limit for the RMS position error of a formation."""
MIN_PUSH_M = 0.3
"""Minimum displacement by a push of 1 m/s for a second."""


class FormationMonitor:
    """Measures a formation by a separate subscription, independent of the example."""

    def __init__(self, radius_m: float) -> None:
        angles = np.arange(ROBOTS) * (2.0 * np.pi / ROBOTS)
        self.targets_m = radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        self.is_formed = False
        self.ids: list[int] = []
        """Robot at each target, once the circle was reached."""
        self.farthest_m = np.zeros(ROBOTS)
        """Largest position error since then, by target."""
        self.rms_m = float("inf")

    def update(self, snapshot: Snapshot) -> None:
        at_m = snapshot.positions_m[:, :2]
        if len(at_m) != ROBOTS:
            self.rms_m = float("inf")
            return
        error_m = np.linalg.norm(at_m[:, None] - self.targets_m[None], axis=-1)
        if not self.is_formed:
            nearest = error_m.argmin(axis=0)
            self.is_formed = len(set(nearest.tolist())) == ROBOTS and rms(error_m.min(axis=0)) <= TOLERANCE_M
            self.ids = snapshot.ids[nearest].tolist()
        if self.is_formed:
            rows = [snapshot.index(object_id) for object_id in self.ids]
            assert None not in rows, f"expected {self.ids}, found {snapshot.ids}"
            own_m = error_m[rows, range(ROBOTS)]
            self.farthest_m = np.maximum(self.farthest_m, own_m)
            self.rms_m = rms(own_m)


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


def test_robots_form_a_circle_and_keep_it_while_one_is_pushed_away(own_server: list[Server]) -> None:
    own_server.append(Server())
    url, radius_m = own_server[0].url, 1.8
    monitor = FormationMonitor(radius_m)
    with Client.connect(url) as client:
        wait_until_all_tracked(client)
        command = [sys.executable, str(EXAMPLES / "formation.py"), "--server", url, "--radius", str(radius_m)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as driving:
            for snapshot in client.snapshots():
                monitor.update(snapshot)
                if driving.poll() is not None:
                    break
            assert driving.stdout is not None
            output = driving.stdout.read()
        assert driving.returncode == 0, output
        # Robots without commands stop, so they stay where the example left them.
        monitor.update(client.snapshot())
    found = re.search(r"^pushing robot (\d+) away$", output, re.MULTILINE)
    assert found and monitor.is_formed, output
    pushed = monitor.ids.index(int(found[1]))
    assert monitor.farthest_m[pushed] >= MIN_PUSH_M, (monitor.farthest_m, output)
    # The push moved only this robot.
    others_m = np.delete(monitor.farthest_m, pushed)
    assert others_m.max() <= MIN_PUSH_M / 2.0, (monitor.farthest_m, output)
    assert monitor.rms_m <= TOLERANCE_M, (monitor.rms_m, output)


def test_without_a_push_the_formation_example_fails(own_server: list[Server]) -> None:
    own_server.append(Server())
    script = (EXAMPLES / "formation.py").read_text()
    push = "client.push(pushed, outwards, duration_s=1.0)"
    assert push in script
    command = [sys.executable, "-c", script.replace(push, "pass"), "--server", own_server[0].url]
    result = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S)
    assert result.returncode == 1
    assert "expected the push to take robot" in result.stderr, result.stdout + result.stderr


def test_the_formation_example_reports_a_lost_server(own_server: list[Server]) -> None:
    own_server.append(Server())
    command = [sys.executable, str(EXAMPLES / "formation.py"), "--server", own_server[0].url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as driving:
        assert driving.stdout is not None and "forming: rms" in driving.stdout.readline()
        own_server[0].kill()
        output = driving.communicate(timeout=TIMEOUT_S)[1]
    assert driving.returncode == 1
    assert re.search("no answer from|no snapshot within 2 s", output) and "Traceback" not in output, output


def test_the_formation_example_reports_missing_robots(server: Server) -> None:
    script = (EXAMPLES / "formation.py").read_text().replace("TIMEOUT_S = 60.0", "TIMEOUT_S = 3.0")
    command = [sys.executable, "-c", script, "--server", server.url, "--robots", str(ROBOTS + 1)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S)
    assert result.returncode == 1
    assert f"expected {ROBOTS + 1} observed robots within 3 s, found {ROBOTS}" in result.stderr


def test_the_csv_file_has_a_line_for_each_robot_of_each_snapshot(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    command = [sys.executable, str(EXAMPLES / "record.py"), str(file), "--server", server.url]
    there: dict[int, list[int]] = {}
    with Client.connect(server.url) as client:
        wait_until_all_tracked(client)
        recording = subprocess.Popen([*command, "--seconds", "1", "--rate", "20"], stderr=subprocess.PIPE, text=True)
        with recording:
            # On a busy machine a robot may be lost, so compare with the snapshots received here.
            for snapshot in client.snapshots():
                there[snapshot.sequence] = snapshot.ids.tolist()
                if recording.poll() is not None:
                    break
            assert recording.stderr is not None
            output = recording.stderr.read()
    assert recording.returncode == 0, output
    with file.open(newline="") as text:
        lines = list(csv.DictReader(text))
    written: dict[int, list[int]] = {}
    for line in lines:
        written.setdefault(int(line["sequence"]), []).append(int(line["object_id"]))
        assert abs(np.linalg.norm([float(line[key]) for key in ("qx", "qy", "qz", "qw")]) - 1.0) < 1e-5
        assert 0.0 < float(line["sx_m"])
    both = written.keys() & there.keys()
    assert len(both) > 3 and {key: written[key] for key in both} == {key: there[key] for key in both}
    assert f"{len(written)} snapshots written" in output
    assert list(written) == sorted(written)
    assert list(lines[0]) == (
        "pose_time_ns,source_id,sequence,object_id,name,stage,"
        "x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,qx,qy,qz,qw,sx_m,sy_m,sz_m"
    ).split(",")


def test_recording_ends_in_time_without_snapshots(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    # The second snapshot follows after a thousand seconds.
    command = [sys.executable, str(EXAMPLES / "record.py"), str(file), "--server", server.url]
    result = subprocess.run(
        [*command, "--seconds", "2", "--rate", "0.001"], capture_output=True, text=True, timeout=TIMEOUT_S
    )
    assert result.returncode == 0 and "snapshots written" in result.stderr, result.stderr


def test_the_csv_file_distinguishes_two_runs_of_a_server(own_server: list[Server], tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    own_server.append(Server())
    address, url = own_server[0].address, own_server[0].url
    sources = []
    with Client.connect(url) as client:
        sources.append(wait_until_all_tracked(client).source_id)
        command = [sys.executable, str(EXAMPLES / "record.py"), "-", "--server", url, "--seconds", str(TIMEOUT_S)]
        with file.open("w") as out, subprocess.Popen(command, stdout=out, stderr=subprocess.PIPE, text=True) as recording:
            assert recording.stderr is not None
            wait_until_contains(file, sources[0])
            own_server[0].kill()
            assert recording.stderr.readline().startswith("connection lost")
            own_server.append(Server(address))
            sources.append(wait_until_all_tracked(client).source_id)
            while "server restarted with new ids" not in (line := recording.stderr.readline()):
                assert line.startswith("connection lost"), line
            wait_until_contains(file, sources[1])
            recording.kill()
    with file.open(newline="") as text:
        lines = list(csv.DictReader(text))
    # The last line may be truncated.
    assert list(dict.fromkeys(line["source_id"] for line in lines[:-1])) == sources


def wait_until_contains(file: Path, text: str) -> None:
    """Waits until the file contains a text."""
    end = time.monotonic() + TIMEOUT_S
    while text not in file.read_text():
        assert time.monotonic() < end, f"{file} does not contain {text}"
        time.sleep(0.05)


def test_the_follow_example_prints_a_robot(server: Server) -> None:
    with Client.connect(server.url) as client:
        object_id = int(wait_until_all_tracked(client).ids[0])
    command = [sys.executable, str(EXAMPLES / "follow.py"), str(object_id), server.url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as following:
        assert following.stdout is not None
        lines = [following.stdout.readline() for _ in range(3)]
        following.kill()
    assert all("m/s  sigma" in line and ("seen" in line or "predicted" in line) for line in lines)
    command[2] = "missing"
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as waiting:
        assert waiting.stdout is not None and waiting.stderr is not None
        assert waiting.stderr.readline().startswith("missing is not tracked yet; tracked are ['")
        assert waiting.stdout.readline() == "missing is not tracked\n"
        waiting.kill()


def test_the_follow_example_survives_a_server_restart_by_code(own_server: list[Server]) -> None:
    own_server.append(Server("127.0.0.1:0", "--preset", "r4"))
    address = own_server[0].address
    with Client.connect(own_server[0].url) as client:
        code = next(number for snapshot in client.snapshots() for number in snapshot.codes if number is not None)
    command = [sys.executable, str(EXAMPLES / "follow.py"), f"#{code}", own_server[0].url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as following:
        assert following.stdout is not None and following.stderr is not None
        assert "m/s  sigma" in following.stdout.readline()
        own_server[0].kill()
        assert following.stderr.readline().startswith("connection lost")
        own_server.append(Server(address, "--preset", "r4"))
        while "server restarted" not in following.stderr.readline():
            assert following.poll() is None
        while "m/s  sigma" not in following.stdout.readline():
            assert following.poll() is None
        following.kill()
