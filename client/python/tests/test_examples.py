"""The examples, run as their users run them."""

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
from test_client import until_all_are_there

from roundel import Client, Snapshot

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PATIENCE_S = 180.0
GOOD_M = 0.03
"""Root mean square distance from the places that a formation may have."""
PUSHED_M = 0.3
"""So far a push of a second at 1 m/s must take its robot."""


class Watch:
    """What a subscriber of its own sees of a formation, whatever those who drive it say."""

    def __init__(self, radius_m: float) -> None:
        angles = np.arange(ROBOTS) * (2.0 * np.pi / ROBOTS)
        self.places_m = radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        self.stood = False
        self.ids: list[int] = []
        """Who stands at each place, once the circle has stood."""
        self.farthest_m = np.zeros(ROBOTS)
        """From its place since then, by place."""
        self.rms_m = float("inf")

    def see(self, snapshot: Snapshot) -> None:
        at_m = snapshot.positions_m[:, :2]
        if len(at_m) != ROBOTS:
            self.rms_m = float("inf")
            return
        off_m = np.linalg.norm(at_m[:, None] - self.places_m[None], axis=-1)
        if not self.stood:
            nearest = off_m.argmin(axis=0)
            self.stood = len(set(nearest.tolist())) == ROBOTS and rms(off_m.min(axis=0)) <= GOOD_M
            self.ids = snapshot.ids[nearest].tolist()
        if self.stood:
            rows = [snapshot.index(object_id) for object_id in self.ids]
            assert None not in rows, f"of {self.ids} there are {snapshot.ids}"
            own_m = off_m[rows, range(ROBOTS)]
            self.farthest_m = np.maximum(self.farthest_m, own_m)
            self.rms_m = rms(own_m)


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


def test_robots_form_a_circle_and_keep_it_while_one_is_pushed_away(own_server: list[Server]) -> None:
    own_server.append(Server())
    url, radius_m = own_server[0].url, 1.8
    watch = Watch(radius_m)
    with Client.connect(url) as client:
        until_all_are_there(client)
        command = [sys.executable, str(EXAMPLES / "formation.py"), "--server", url, "--radius", str(radius_m)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as driving:
            for snapshot in client.snapshots():
                watch.see(snapshot)
                if driving.poll() is not None:
                    break
            assert driving.stdout is not None
            said = driving.stdout.read()
        assert driving.returncode == 0, said
        # Robots that hear nothing stop, so they stand where the example left them.
        watch.see(client.snapshot())
    found = re.search(r"^pushing robot (\d+) away$", said, re.MULTILINE)
    assert found and watch.stood, said
    pushed = watch.ids.index(int(found[1]))
    assert watch.farthest_m[pushed] >= PUSHED_M, (watch.farthest_m, said)
    # The push takes nobody else along: it was this robot that came back.
    others_m = np.delete(watch.farthest_m, pushed)
    assert others_m.max() <= PUSHED_M / 2.0, (watch.farthest_m, said)
    assert watch.rms_m <= GOOD_M, (watch.rms_m, said)


def test_without_a_push_the_formation_example_fails(own_server: list[Server]) -> None:
    own_server.append(Server())
    script = (EXAMPLES / "formation.py").read_text()
    push = "client.push(pushed, outwards, duration_s=1.0)"
    assert push in script
    command = [sys.executable, "-c", script.replace(push, "pass"), "--server", own_server[0].url]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert ended.returncode == 1
    assert "expected the push to take robot" in ended.stderr, ended.stdout + ended.stderr


def test_a_formation_whose_server_dies_ends_and_says_why(own_server: list[Server]) -> None:
    own_server.append(Server())
    command = [sys.executable, str(EXAMPLES / "formation.py"), "--server", own_server[0].url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as driving:
        assert driving.stdout is not None and "forming: rms" in driving.stdout.readline()
        own_server[0].kill()
        said = driving.communicate(timeout=PATIENCE_S)[1]
    assert driving.returncode == 1
    assert re.search("no answer from|no snapshot within 2 s", said) and "Traceback" not in said, said


def test_too_few_robots_are_told(server: Server) -> None:
    script = (EXAMPLES / "formation.py").read_text().replace("PATIENCE_S = 60.0", "PATIENCE_S = 3.0")
    command = [sys.executable, "-c", script, "--server", server.url, "--robots", str(ROBOTS + 1)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert ended.returncode == 1
    assert f"expected {ROBOTS + 1} robots to be seen within 3 s, found {ROBOTS}" in ended.stderr


def test_a_recording_has_a_line_for_each_robot_of_each_snapshot(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    command = [sys.executable, str(EXAMPLES / "record.py"), str(file), "--server", server.url]
    there: dict[int, list[int]] = {}
    with Client.connect(server.url) as client:
        until_all_are_there(client)
        recording = subprocess.Popen([*command, "--seconds", "1", "--rate", "20"], stderr=subprocess.PIPE, text=True)
        with recording:
            # On a busy machine a robot may be lost meanwhile: what is to be written is what is seen here too.
            for snapshot in client.snapshots():
                there[snapshot.sequence] = snapshot.ids.tolist()
                if recording.poll() is not None:
                    break
            assert recording.stderr is not None
            said = recording.stderr.read()
    assert recording.returncode == 0, said
    with file.open(newline="") as text:
        lines = list(csv.DictReader(text))
    written: dict[int, list[int]] = {}
    for line in lines:
        written.setdefault(int(line["sequence"]), []).append(int(line["object_id"]))
        assert abs(np.linalg.norm([float(line[key]) for key in ("qx", "qy", "qz", "qw")]) - 1.0) < 1e-5
        assert 0.0 < float(line["sx_m"])
    both = written.keys() & there.keys()
    assert len(both) > 3 and {key: written[key] for key in both} == {key: there[key] for key in both}
    assert f"{len(written)} snapshots written" in said
    assert list(written) == sorted(written)
    assert list(lines[0]) == (
        "pose_time_ns,source_id,sequence,object_id,name,stage,"
        "x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,qx,qy,qz,qw,sx_m,sy_m,sz_m"
    ).split(",")


def test_a_recording_ends_in_time_while_nothing_comes(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    # After the first snapshot there is nothing for a thousand seconds.
    command = [sys.executable, str(EXAMPLES / "record.py"), str(file), "--server", server.url]
    ended = subprocess.run(
        [*command, "--seconds", "2", "--rate", "0.001"], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert ended.returncode == 0 and "snapshots written" in ended.stderr, ended.stderr


def test_a_recording_tells_the_robots_of_two_starts_of_a_server_apart(own_server: list[Server], tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    own_server.append(Server())
    address, url = own_server[0].address, own_server[0].url
    sources = []
    with Client.connect(url) as client:
        sources.append(until_all_are_there(client).source_id)
        command = [sys.executable, str(EXAMPLES / "record.py"), "-", "--server", url, "--seconds", str(PATIENCE_S)]
        with file.open("w") as out, subprocess.Popen(command, stdout=out, stderr=subprocess.PIPE, text=True) as recording:
            assert recording.stderr is not None
            until_it_has(file, sources[0])
            own_server[0].kill()
            assert recording.stderr.readline().startswith("lost the server")
            own_server.append(Server(address))
            sources.append(until_all_are_there(client).source_id)
            while "started anew, and gives ids anew" not in (line := recording.stderr.readline()):
                assert line.startswith("lost the server"), line
            until_it_has(file, sources[1])
            recording.kill()
    with file.open(newline="") as text:
        lines = list(csv.DictReader(text))
    # The last line may be cut off.
    assert list(dict.fromkeys(line["source_id"] for line in lines[:-1])) == sources


def until_it_has(file: Path, word: str) -> None:
    """Until that stands in the file."""
    end = time.monotonic() + PATIENCE_S
    while word not in file.read_text():
        assert time.monotonic() < end, f"{file} has no {word}"
        time.sleep(0.05)


def test_one_robot_is_followed(server: Server) -> None:
    with Client.connect(server.url) as client:
        object_id = int(until_all_are_there(client).ids[0])
    command = [sys.executable, str(EXAMPLES / "follow.py"), str(object_id), server.url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as following:
        assert following.stdout is not None
        lines = [following.stdout.readline() for _ in range(3)]
        following.kill()
    assert all("m/s  sigma" in line and ("seen" in line or "predicted" in line) for line in lines)
    command[2] = "nobody"
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as waiting:
        assert waiting.stdout is not None and waiting.stderr is not None
        assert waiting.stderr.readline().startswith("nobody is not seen yet; there are ['")
        assert waiting.stdout.readline() == "nobody is not there\n"
        waiting.kill()


def test_a_robot_is_followed_by_its_code_through_a_start_of_the_server(own_server: list[Server]) -> None:
    own_server.append(Server("127.0.0.1:0", "--preset", "r4"))
    address = own_server[0].address
    with Client.connect(own_server[0].url) as client:
        code = next(number for snapshot in client.snapshots() for number in snapshot.codes if number is not None)
    command = [sys.executable, str(EXAMPLES / "follow.py"), f"#{code}", own_server[0].url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as following:
        assert following.stdout is not None and following.stderr is not None
        assert "m/s  sigma" in following.stdout.readline()
        own_server[0].kill()
        assert following.stderr.readline().startswith("lost the server")
        own_server.append(Server(address, "--preset", "r4"))
        while "started anew" not in following.stderr.readline():
            assert following.poll() is None
        while "m/s  sigma" not in following.stdout.readline():
            assert following.poll() is None
        following.kill()
