"""The plain client and the asyncio one, against a real server."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
import threading
import time
from pathlib import Path
from typing import Callable, TypeVar

import numpy as np
import pytest
from conftest import ROBOTS, Server

from roundel import (
    Client,
    Disconnected,
    NotRoundel,
    Reconnected,
    Refused,
    RoundelError,
    Snapshot,
    Subscription,
    Unreachable,
    _calls,
    aio,
    v1,
)

PATIENCE_S = 60.0
T = TypeVar("T")


def until_all_are_there(client: Client) -> Snapshot:
    """The first snapshot with every robot tracked."""
    deadline = time.monotonic() + PATIENCE_S
    for snapshot in client.snapshots():
        if len(snapshot) == ROBOTS and all(snapshot.stages == v1.LIFE_STAGE_TRACKED):
            return snapshot
        assert time.monotonic() < deadline, f"{len(snapshot)} of {ROBOTS} robots are there"
    raise AssertionError("the stream ended")


def test_everything_that_can_be_asked_is_answered(server: Server) -> None:
    with Client.connect(server.url) as client:
        snapshot = until_all_are_there(client)
        assert client.info().name == "demo"
        assert client.info().source_id == snapshot.source_id
        assert [camera.name for camera in client.cameras()] == [f"camera-{i}" for i in range(4)]
        assert {one.object_id for one in client.objects()} >= set(snapshot.ids.tolist())
        assert client.snapshot().sequence >= snapshot.sequence
        assert client.calibration().stage == v1.CALIBRATION_STAGE_IDLE
        assert client.camera_setup("camera-1").source.startswith("sim:")
        kinds = {event.kind for event in itertools.islice(client.events(backlog=50), 4)}
        assert kinds <= {v1.EVENT_KIND_CAMERA_RUNNING, v1.EVENT_KIND_OBJECT_APPEARED}
        frames = list(itertools.islice(client.observations(["camera-2"]), 3))
        assert {frame.camera for frame in frames} == {"camera-2"}
        assert frames[2].frame > frames[0].frame
        with pytest.raises(Refused, match="no camera \"camera-9\"; there are: camera-0"):
            next(client.observations(["camera-9"]))
        picture = client.picture("camera-1")
        assert picture.jpeg[:2] == b"\xff\xd8" and picture.capture_time_ns > 0
        with pytest.raises(Refused, match="camera-9"):
            client.picture("camera-9")
        newest = client.newest_observations(["camera-3", "camera-2"])
        assert [frame.camera for frame in newest] == ["camera-2", "camera-3"]
        assert newest[0].frame >= frames[2].frame


def test_a_recording_is_begun_ended_and_listed(tmp_path: Path, own_server: list[Server]) -> None:
    own_server.append(Server("127.0.0.1:0", folder=tmp_path))
    with Client.connect(own_server[0].url) as client:
        assert client.recording().state == v1.RECORDING_STATE_IDLE
        with pytest.raises(Refused, match="nothing is being recorded"):
            client.stop_recording()
        begun = client.start_recording("trial", frames_every=0)
        assert begun.state == v1.RECORDING_STATE_RECORDING and begun.file.startswith("trial-")
        until_all_are_there(client)
        ended = client.stop_recording()
        assert ended.state == v1.RECORDING_STATE_STOPPED and ended.messages > begun.messages
        listed = client.recordings()
        assert [(file.name, file.bytes, file.open) for file in listed] == [(begun.file, ended.bytes, False)]
        assert (tmp_path / "recordings" / begun.file).stat().st_size == ended.bytes
        # This server plays none and keeps no history: it says so.
        with pytest.raises(Refused, match="roundel replay"):
            client.control_replay(paused=True)
        with pytest.raises(Refused, match="history"):
            client.history([1, "robot"], region_m=((-1, -1, 0), (1, 1, float("inf"))))


def test_what_is_configured_is_read_checked_and_changed(server: Server) -> None:
    with Client.connect(server.url) as client:
        until_all_are_there(client)
        before = client.configuration()
        assert before.name == "demo" and [camera.name for camera in before.cameras][0] == "camera-0"
        kind = before.roundels[0].name
        check = client.check_configuration(before.toml + "\n[limits]\nmax_object = 3\n")
        assert "max_objects" in check.problems[0].message and check.problems[0].line > 0
        added = client.add_object(v1.ObjectSetup(name="mascot", roundel=kind))
        assert added.object.name == "mascot" and added.kept
        renamed = client.change_object("mascot", v1.ObjectSetup(name="idol"), ["name"])
        assert renamed.object.name == "idol" and client.object_setup("idol").roundel == kind
        assert renamed.object_id in client.snapshot().ids
        with pytest.raises(Refused, match="no object \"mascot\""):
            client.remove_object("mascot")
        client.remove_object("idol")
        assert client.configuration().version == before.version
        with pytest.raises(Refused, match="nothing tells it from them"):
            client.name_object(int(client.snapshot().ids[0]), "one of many")
        with pytest.raises(Refused, match="line 1, column 1"):
            client.apply_configuration("")
        limited = before.toml + "\n[limits]\nmax_objects = 500\n"
        applied = client.apply_configuration(limited, before.version)
        assert applied.changes == ["[fusion] or [limits] max_objects"]
        assert client.apply_configuration(before.toml).version == before.version


def test_a_subscription_is_kept_to(server: Server) -> None:
    with Client.connect(server.url) as client:
        chosen = until_all_are_there(client).ids[:2].tolist()
        with client.updates(Subscription(ids=chosen, covariance=False, max_rate_hz=20.0)) as updates:
            snapshots = [u for u in itertools.islice(updates, 5) if isinstance(u, Snapshot)]
        assert all(snapshot.ids.tolist() == chosen for snapshot in snapshots)
        assert snapshots[0].covariances is None
        assert np.all(np.diff([s.pose_time_ns for s in snapshots]) > 0)
        whole = next(client.snapshots())
        assert whole.covariances is not None
        assert np.all(np.linalg.eigvalsh(whole.covariances) > 0.0)
        kind = whole[0].roundel
        assert len(next(client.snapshots(Subscription(roundels=[kind])))) > 0
        for wrong, why in [
            (Subscription(roundels=["unheard"]), f"roundels: expected any of .*{kind}"),
            (Subscription(max_rate_hz=-1.0), "max_rate_hz: expected a rate above 0"),
            (Subscription(horizon_s=2.0), "horizon_ms: expected milliseconds from 0 to 1000"),
        ]:
            with pytest.raises(Refused, match=why):
                next(client.snapshots(wrong))


def until(client: Client, subscription: Subscription, holds: Callable[[Snapshot], bool]) -> Snapshot:
    """The first snapshot of which it holds."""
    deadline = time.monotonic() + PATIENCE_S
    for snapshot in client.snapshots(subscription):
        if holds(snapshot):
            return snapshot
        assert time.monotonic() < deadline, f"{snapshot.ids}, {snapshot.names}, {snapshot.codes}"
    raise AssertionError("the stream ended")


def test_objects_are_chosen_by_name_code_and_id(own_server: list[Server]) -> None:
    own_server.append(Server("127.0.0.1:0", "--preset", "r4"))
    with Client.connect(own_server[0].url) as client:
        parked = {reference.code for reference in client.configuration().references}
        seen = until(client, Subscription(), lambda s: len(set(s.codes) - {None, *parked}) >= 2)
        first, second = [robot for robot in map(seen.__getitem__, range(len(seen))) if robot.code not in {None, *parked}][:2]
        client.name_object(second.object_id, "cart")
        # Names and codes stay with the robots, also of one that is lost on a busy machine and comes back with another id.
        subscription = Subscription(names=["cart"], codes=[first.code or 0], covariance=False)
        both = until(client, subscription, lambda s: s.robot("cart") is not None and s.coded(first.code or 0) is not None)
        assert both.covariances is None and set(both.codes) == {first.code, second.code}
        assert set(client.snapshot(subscription).codes) <= {first.code, second.code}
        assert set(client.snapshot(Subscription(ids=[first.object_id])).ids.tolist()) <= {first.object_id}
        assert len(client.snapshot(Subscription(names=["nobody"]))) == 0
        with pytest.raises(Refused, match="names") as refused:
            client.snapshot(Subscription(names=[""]))
        assert (refused.value.field or "").startswith("names")


def test_prediction_is_the_servers_own(server: Server) -> None:
    horizon_s = 0.2
    with Client.connect(server.url) as client:
        until_all_are_there(client)
        now, ahead = {}, {}
        streams = [(now, client.snapshots()), (ahead, client.snapshots(Subscription(horizon_s=horizon_s)))]
        while not (both := now.keys() & ahead.keys()):
            for kept, stream in streams:
                snapshot = next(stream)
                kept[snapshot.sequence] = snapshot
        sequence = both.pop()
        own, theirs = now[sequence].predicted(horizon_s), ahead[sequence]
        assert own.pose_time_ns == theirs.pose_time_ns
        np.testing.assert_allclose(own.positions_m, theirs.positions_m, atol=1e-9)
        np.testing.assert_allclose(own.velocities_m_s, theirs.velocities_m_s, atol=1e-9)
        # Of plain roundels the yaw is a convention; the normal is not.
        np.testing.assert_allclose(own.rotations[:, :, 2], theirs.rotations[:, :, 2], atol=1e-9)
        assert np.abs(own.positions_m - now[sequence].positions_m).max() > 0.01


def test_the_clocks_of_one_machine_differ_by_less_than_their_bound(server: Server) -> None:
    with Client.connect(server.url) as client:
        offset = client.clock_offset()
        # The server's clock was set to Unix time when it started, and drifts at most a little since.
        assert abs(offset.offset_ns) < offset.round_trip_ns + 50_000_000
        assert 0 <= offset.deviation_ns <= offset.round_trip_ns
        snapshot = client.snapshot()
        age_s = (offset.server_now_ns() - snapshot.pose_time_ns) * 1e-9
        assert -0.05 < age_s < 5.0


def test_the_newest_value_is_always_at_hand(server: Server) -> None:
    with Client.connect(server.url) as client, client.latest() as latest:
        first = latest.next(PATIENCE_S)
        while latest.skipped < 5:
            time.sleep(0.02)
        newest = latest.value
        assert newest is not None
        assert newest.sequence >= first.sequence + 6
        following = latest.next(PATIENCE_S)
        assert following.sequence > newest.sequence
        assert (newest.sequence - first.sequence) + 1 >= latest.skipped - latest.missed
        with pytest.raises(TimeoutError):
            for _ in range(1000):
                latest.next(timeout_s=0.0)


def test_a_refused_subscription_ends_the_newest_value_with_its_error(server: Server) -> None:
    with Client.connect(server.url) as client, client.latest(Subscription(ids=[0])) as latest:
        with pytest.raises(Refused, match="object_ids"):
            latest.next(PATIENCE_S)


def test_what_a_slow_reader_missed_is_counted(server: Server) -> None:
    with Client.connect(server.url) as client:
        until_all_are_there(client)
        with client.updates() as updates:
            first = next(updates)
            assert isinstance(first, Snapshot)
            newest, accounted = first, first.sequence
            deadline = time.monotonic() + PATIENCE_S
            while updates.missed == 0:
                assert time.monotonic() < deadline
                # Longer than what is under way lasts.
                time.sleep(1.5)
                for _ in range(3):
                    update = next(updates)
                    assert isinstance(update, Snapshot)
                    newest, accounted = update, accounted + 1 + update.missed
            assert newest.sequence == accounted


def test_closing_from_another_thread_lets_go(server: Server) -> None:
    with Client.connect(server.url) as client:
        updates = client.updates(Subscription(ids=[10**9], max_rate_hz=0.01))
        next(updates)
        threading.Timer(0.2, updates.close).start()
        assert list(updates) == []


def test_a_killed_server_comes_back_and_the_gap_is_told(own_server: list[Server]) -> None:
    own_server.append(Server())
    address = own_server[0].address
    with Client.connect(own_server[0].url) as client, client.updates() as updates:
        assert isinstance(next(updates), Snapshot)
        own_server[0].kill()
        seen: list[object] = []
        deadline = time.monotonic() + PATIENCE_S
        for update in updates:
            assert time.monotonic() < deadline
            if isinstance(update, Snapshot):
                if any(isinstance(one, Reconnected) for one in seen):
                    break
                continue
            seen.append(update)
            if isinstance(update, Disconnected) and update.tries == 1:
                own_server.append(Server(address))
        losses = [one for one in seen if isinstance(one, Disconnected)]
        assert [one.tries for one in losses] == list(range(len(losses)))
        assert all(0.05 <= one.retry_in_s <= 5.0 and one.reason for one in losses)
        # Another server: what was missed of it cannot be known.
        assert isinstance(seen[-1], Reconnected) and seen[-1].missed is None and seen[-1].restarted
        assert 0.0 < seen[-1].gap_s < PATIENCE_S


def test_nobody_and_an_older_server_are_told_apart(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Unreachable, match="no answer from http://127.0.0.1:9"):
        Client.connect("http://127.0.0.1:9")
    monkeypatch.setitem(_calls.ANSWERS, "Unheard", v1.ServerInfo)
    with Client(server.url) as client, pytest.raises(NotRoundel, match="does not know this call"):
        client._call("Unheard", v1.GetServerInfoRequest())


def test_a_server_that_takes_its_time_to_answer_is_waited_for(server: Server) -> None:
    """As over a radio link, or on a busy machine."""
    host, port = server.address.split(":")

    def pump(source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                sink.sendall(data)

    def relay() -> None:
        near, _ = listener.accept()
        time.sleep(0.6)
        with near, socket.create_connection((host, int(port))) as far:
            back = threading.Thread(target=pump, args=(far, near))
            back.start()
            pump(near, far)
            with contextlib.suppress(OSError):
                far.shutdown(socket.SHUT_RDWR)
            back.join()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        relaying = threading.Thread(target=relay)
        relaying.start()
        with Client.connect(f"http://127.0.0.1:{listener.getsockname()[1]}") as client:
            assert client.info().name == "demo"
        relaying.join()


def test_only_what_is_simulated_and_sound_is_driven(server: Server) -> None:
    with Client.connect(server.url) as client:
        one = int(until_all_are_there(client).ids[0])
        for velocities, why in [
            ({one: [1.5, 0.0]}, "at most 1 m/s"),
            ({one: [float("nan"), 0.0]}, "at most 1 m/s"),
            ({10**6: [0.1, 0.0]}, "no object"),
        ]:
            with pytest.raises(Refused, match=why):
                client.drive(velocities)
        with pytest.raises(Refused, match="duration_ms"):
            client.push(one, [1.0, 0.0], 60.0)


def run(what: "asyncio.Future[T] | object") -> T:
    return asyncio.run(asyncio.wait_for(what, PATIENCE_S))  # type: ignore[arg-type]


def test_asyncio_gives_the_same(server: Server) -> None:
    async def session() -> None:
        async with await aio.Client.connect(server.url) as client:
            assert (await client.info()).name == "demo"
            assert len(await client.cameras()) == 4
            assert await client.objects()
            assert (await client.snapshot()).sequence > 0
            assert (await client.configuration()).name == "demo"
            with pytest.raises(Refused, match="no object \"nobody\""):
                await client.object_setup("nobody")
            assert [frame.camera for frame in await client.newest_observations(["camera-1"])] == ["camera-1"]
            assert (await client.picture("camera-1")).jpeg[:2] == b"\xff\xd8"
            assert (await client.recording()).state == v1.RECORDING_STATE_IDLE
            assert await client.recordings() == []
            with pytest.raises(Refused, match="roundel replay"):
                await client.replay()
            with pytest.raises(Refused, match="history"):
                await client.history()
            assert abs((await client.clock_offset()).offset_ns) < 10**9
            sequences = []
            async for snapshot in client.snapshots(Subscription(max_rate_hz=30.0)):
                sequences.append(snapshot.sequence)
                if len(sequences) == 5:
                    break
            assert sequences == sorted(set(sequences))
            async with client.latest() as latest:
                first = await latest.next()
                await asyncio.sleep(0.3)
                assert latest.value is not None and latest.value.sequence > first.sequence
                assert latest.skipped > 0
            async for frame in client.observations(["camera-0"]):
                assert frame.camera == "camera-0"
                break
            with pytest.raises(Refused, match="max_rate_hz"):
                async for _ in client.snapshots(Subscription(max_rate_hz=0.0)):
                    pass
            async with client.latest(Subscription(ids=[0])) as refused:
                with pytest.raises(Refused, match="object_ids"):
                    await refused.next()

    run(session())


def test_asyncio_resumes_too(own_server: list[Server]) -> None:
    async def session() -> list[object]:
        own_server.append(await asyncio.to_thread(Server))
        client = aio.Client(own_server[0].url)
        updates, seen = client.updates(), []
        async for update in updates:
            if not isinstance(update, Snapshot):
                seen.append(update)
                if isinstance(update, Disconnected) and update.tries == 1:
                    own_server.append(await asyncio.to_thread(Server, own_server[0].address))
            elif not seen:
                own_server[0].kill()
            elif isinstance(seen[-1], Reconnected):
                break
        await client.close()
        return seen

    seen = run(session())
    assert isinstance(seen[0], Disconnected) and isinstance(seen[-1], Reconnected)
    assert seen[-1].restarted and seen[-1].missed is None


def test_asyncio_says_when_nobody_is_there() -> None:
    async def session() -> None:
        with pytest.raises(RoundelError, match="no answer"):
            await aio.Client.connect("http://127.0.0.1:9")

    run(session())
