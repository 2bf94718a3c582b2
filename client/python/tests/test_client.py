"""The blocking and the asyncio client against a real server."""

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

TIMEOUT_S = 60.0
T = TypeVar("T")


def wait_until_all_tracked(client: Client) -> Snapshot:
    """The first snapshot with every robot tracked."""
    deadline = time.monotonic() + TIMEOUT_S
    for snapshot in client.snapshots():
        if len(snapshot) == ROBOTS and all(snapshot.stages == v1.LIFE_STAGE_TRACKED):
            return snapshot
        assert time.monotonic() < deadline, f"{len(snapshot)} of {ROBOTS} robots are tracked"
    raise AssertionError("the stream ended")


def test_every_query_gets_a_response(server: Server) -> None:
    with Client.connect(server.url) as client:
        snapshot = wait_until_all_tracked(client)
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


def test_a_recording_is_started_stopped_and_listed(tmp_path: Path, own_server: list[Server]) -> None:
    own_server.append(Server("127.0.0.1:0", folder=tmp_path))
    with Client.connect(own_server[0].url) as client:
        assert client.recording().state == v1.RECORDING_STATE_IDLE
        with pytest.raises(Refused, match="no recording is running"):
            client.stop_recording()
        started = client.start_recording("trial", frames_every=0)
        assert started.state == v1.RECORDING_STATE_RECORDING and started.file.startswith("trial-")
        wait_until_all_tracked(client)
        stopped = client.stop_recording()
        assert stopped.state == v1.RECORDING_STATE_STOPPED and stopped.messages > started.messages
        listed = client.recordings()
        assert [(file.name, file.bytes, file.open) for file in listed] == [(started.file, stopped.bytes, False)]
        assert (tmp_path / "recordings" / started.file).stat().st_size == stopped.bytes
        # This server has neither a replay nor a history.
        with pytest.raises(Refused, match="roundel replay"):
            client.control_replay(paused=True)
        with pytest.raises(Refused, match="history"):
            client.history([1, "robot"], region_m=((-1, -1, 0), (1, 1, float("inf"))))


def test_the_configuration_is_read_checked_and_changed(server: Server) -> None:
    with Client.connect(server.url) as client:
        wait_until_all_tracked(client)
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


def test_a_subscription_filters_snapshots(server: Server) -> None:
    with Client.connect(server.url) as client:
        chosen = wait_until_all_tracked(client).ids[:2].tolist()
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
        for subscription, reason in [
            (Subscription(roundels=["unknown"]), f"roundels: expected any of .*{kind}"),
            (Subscription(max_rate_hz=-1.0), "max_rate_hz: expected a rate above 0"),
            (Subscription(horizon_s=2.0), "horizon_ms: expected milliseconds from 0 to 1000"),
        ]:
            with pytest.raises(Refused, match=reason):
                next(client.snapshots(subscription))


def wait_until(client: Client, subscription: Subscription, holds: Callable[[Snapshot], bool]) -> Snapshot:
    """The first snapshot for which `holds` is true."""
    deadline = time.monotonic() + TIMEOUT_S
    for snapshot in client.snapshots(subscription):
        if holds(snapshot):
            return snapshot
        assert time.monotonic() < deadline, f"{snapshot.ids}, {snapshot.names}, {snapshot.codes}"
    raise AssertionError("the stream ended")


def test_objects_are_selected_by_name_code_and_id(own_server: list[Server]) -> None:
    own_server.append(Server("127.0.0.1:0", "--preset", "r4"))
    with Client.connect(own_server[0].url) as client:
        parked = {reference.code for reference in client.configuration().references}
        seen = wait_until(client, Subscription(), lambda s: len(set(s.codes) - {None, *parked}) >= 2)
        first, second = [robot for robot in map(seen.__getitem__, range(len(seen))) if robot.code not in {None, *parked}][:2]
        client.name_object(second.object_id, "cart")
        # A robot lost on a busy machine gets another id, but keeps its name and code.
        subscription = Subscription(names=["cart"], codes=[first.code or 0], covariance=False)
        both = wait_until(client, subscription, lambda s: s.robot("cart") is not None and s.coded(first.code or 0) is not None)
        assert both.covariances is None and set(both.codes) == {first.code, second.code}
        assert set(client.snapshot(subscription).codes) <= {first.code, second.code}
        assert set(client.snapshot(Subscription(ids=[first.object_id])).ids.tolist()) <= {first.object_id}
        assert len(client.snapshot(Subscription(names=["missing"]))) == 0
        with pytest.raises(Refused, match="names") as refused:
            client.snapshot(Subscription(names=[""]))
        assert (refused.value.field or "").startswith("names")


def test_prediction_matches_the_server(server: Server) -> None:
    horizon_s = 0.2
    with Client.connect(server.url) as client:
        wait_until_all_tracked(client)
        now, ahead = {}, {}
        streams = [(now, client.snapshots()), (ahead, client.snapshots(Subscription(horizon_s=horizon_s)))]
        while not (both := now.keys() & ahead.keys()):
            for kept, stream in streams:
                snapshot = next(stream)
                kept[snapshot.sequence] = snapshot
        sequence = both.pop()
        predicted, expected = now[sequence].predicted(horizon_s), ahead[sequence]
        assert predicted.pose_time_ns == expected.pose_time_ns
        np.testing.assert_allclose(predicted.positions_m, expected.positions_m, atol=1e-9)
        np.testing.assert_allclose(predicted.velocities_m_s, expected.velocities_m_s, atol=1e-9)
        # The yaw of a plain roundel is only a convention, so compare the normals.
        np.testing.assert_allclose(predicted.rotations[:, :, 2], expected.rotations[:, :, 2], atol=1e-9)
        assert np.abs(predicted.positions_m - now[sequence].positions_m).max() > 0.01


def test_the_clock_offset_on_one_machine_is_within_its_bound(server: Server) -> None:
    with Client.connect(server.url) as client:
        offset = client.clock_offset()
        # The server's clock was set to Unix time at its start and has drifted little since.
        assert abs(offset.offset_ns) < offset.round_trip_ns + 50_000_000
        assert 0 <= offset.deviation_ns <= offset.round_trip_ns
        snapshot = client.snapshot()
        age_s = (offset.server_now_ns() - snapshot.pose_time_ns) * 1e-9
        assert -0.05 < age_s < 5.0


def test_the_newest_snapshot_is_always_available(server: Server) -> None:
    with Client.connect(server.url) as client, client.latest() as latest:
        first = latest.next(TIMEOUT_S)
        while latest.skipped < 5:
            time.sleep(0.02)
        newest = latest.value
        assert newest is not None
        assert newest.sequence >= first.sequence + 6
        following = latest.next(TIMEOUT_S)
        assert following.sequence > newest.sequence
        assert (newest.sequence - first.sequence) + 1 >= latest.skipped - latest.missed
        with pytest.raises(TimeoutError):
            for _ in range(1000):
                latest.next(timeout_s=0.0)


def test_latest_raises_the_error_of_a_rejected_subscription(server: Server) -> None:
    with Client.connect(server.url) as client, client.latest(Subscription(ids=[0])) as latest:
        with pytest.raises(Refused, match="object_ids"):
            latest.next(TIMEOUT_S)


def test_snapshots_missed_by_a_slow_reader_are_counted(server: Server) -> None:
    with Client.connect(server.url) as client:
        wait_until_all_tracked(client)
        with client.updates() as updates:
            first = next(updates)
            assert isinstance(first, Snapshot)
            newest, accounted = first, first.sequence
            deadline = time.monotonic() + TIMEOUT_S
            while updates.missed == 0:
                assert time.monotonic() < deadline
                # Longer than buffered snapshots last.
                time.sleep(1.5)
                for _ in range(3):
                    update = next(updates)
                    assert isinstance(update, Snapshot)
                    newest, accounted = update, accounted + 1 + update.missed
            assert newest.sequence == accounted


def test_close_from_another_thread_ends_iteration(server: Server) -> None:
    with Client.connect(server.url) as client:
        updates = client.updates(Subscription(ids=[10**9], max_rate_hz=0.01))
        next(updates)
        threading.Timer(0.2, updates.close).start()
        assert list(updates) == []


def test_a_restarted_server_is_reported_with_its_gap(own_server: list[Server]) -> None:
    own_server.append(Server())
    address = own_server[0].address
    with Client.connect(own_server[0].url) as client, client.updates() as updates:
        assert isinstance(next(updates), Snapshot)
        own_server[0].kill()
        seen: list[object] = []
        deadline = time.monotonic() + TIMEOUT_S
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
        # Sequence numbers of another run cannot be compared.
        assert isinstance(seen[-1], Reconnected) and seen[-1].missed is None and seen[-1].restarted
        assert 0.0 < seen[-1].gap_s < TIMEOUT_S


def test_an_unused_port_and_an_older_server_raise_different_errors(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(Unreachable, match="no answer from http://127.0.0.1:9"):
        Client.connect("http://127.0.0.1:9")
    monkeypatch.setitem(_calls.RESPONSES, "UnknownCall", v1.ServerInfo)
    with Client(server.url) as client, pytest.raises(NotRoundel, match="does not support this call"):
        client._call("UnknownCall", v1.GetServerInfoRequest())


def test_a_slow_connection_succeeds(server: Server) -> None:
    """As over a radio link or on a busy machine."""
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


def test_invalid_robot_commands_are_rejected(server: Server) -> None:
    with Client.connect(server.url) as client:
        one = int(wait_until_all_tracked(client).ids[0])
        for velocities, why in [
            ({one: [1.5, 0.0]}, "at most 1 m/s"),
            ({one: [float("nan"), 0.0]}, "at most 1 m/s"),
            ({10**6: [0.1, 0.0]}, "no object"),
        ]:
            with pytest.raises(Refused, match=why):
                client.drive(velocities)
        with pytest.raises(Refused, match="duration_ms"):
            client.push(one, [1.0, 0.0], 60.0)


def run(session: "asyncio.Future[T] | object") -> T:
    return asyncio.run(asyncio.wait_for(session, TIMEOUT_S))  # type: ignore[arg-type]


def test_the_asyncio_client_gives_the_same(server: Server) -> None:
    async def session() -> None:
        async with await aio.Client.connect(server.url) as client:
            assert (await client.info()).name == "demo"
            assert len(await client.cameras()) == 4
            assert await client.objects()
            assert (await client.snapshot()).sequence > 0
            assert (await client.configuration()).name == "demo"
            with pytest.raises(Refused, match="no object \"missing\""):
                await client.object_setup("missing")
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


def test_the_asyncio_client_reconnects(own_server: list[Server]) -> None:
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


def test_the_asyncio_client_reports_an_unreachable_server() -> None:
    async def session() -> None:
        with pytest.raises(RoundelError, match="no answer"):
            await aio.Client.connect("http://127.0.0.1:9")

    run(session())
