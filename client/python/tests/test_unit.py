"""What needs no server."""

from __future__ import annotations

import numpy as np
import pytest

from roundel import Conflict, Disconnected, InvalidAddress, LifeStage, Reconnected, Refused, Snapshot, Subscription, Unreachable, v1
from roundel._address import target
from roundel._backoff import FIRST_S, LONGEST_S, Backoff
from roundel._calls import ANSWERS, calibration_request, drive_request, history_request
from roundel._follower import Follower
from roundel.clock import best
from roundel.errors import from_rpc

import grpc


@pytest.mark.parametrize("address", ["127.0.0.1:7670", "http://127.0.0.1:7670", " http://127.0.0.1:7670/ "])
def test_addresses_are_read_with_and_without_a_scheme(address: str) -> None:
    assert target(address) == "127.0.0.1:7670"
    assert target("[::1]:7670") == "[::1]:7670"


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("", "it is empty"),
        ("127.0.0.1", "the port is missing"),
        ("https://arena:7670", "TLS"),
        ("ws://arena:7670", "ws:// is not http://"),
        ("http://arena:7670/api/v1", "/api/v1 stands after the port"),
        ("http://are na:7670", "space"),
        ("http://arena:99999", "ort"),
    ],
)
def test_wrong_addresses_say_why(address: str, why: str) -> None:
    with pytest.raises(InvalidAddress, match=r"expected http://HOST:PORT") as caught:
        target(address)
    assert why in str(caught.value)


def test_pauses_grow_to_the_cap_and_begin_anew() -> None:
    backoff = Backoff()
    pauses = [backoff.next_pause_s() for _ in range(40)]
    assert FIRST_S / 2 <= pauses[0] <= FIRST_S
    assert all(LONGEST_S / 2 <= pause <= LONGEST_S for pause in pauses[8:])
    backoff.reset()
    assert backoff.next_pause_s() <= FIRST_S


def state(object_id: int, **fields: object) -> v1.ObjectState:
    return v1.ObjectState(
        object_id=object_id,
        stage=v1.LIFE_STAGE_TRACKED,
        position=v1.Vector3(x=1.0, y=2.0, z=3.0),
        velocity=v1.Vector3(x=1.0, y=0.0, z=0.0),
        orientation=v1.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
        angular_velocity=v1.Vector3(x=0.0, y=0.0, z=np.pi),
        **fields,  # type: ignore[arg-type]
    )


def test_arrays_have_a_row_for_each_object() -> None:
    # The upper triangle of diag(1, 4, 9, 16, 25, 36) with 0.5 beside, row by row.
    triangle = [float(r * r) if c == r else 0.5 for r in range(1, 7) for c in range(r, 7)]
    objects = [state(3, covariance=triangle), state(9, covariance=triangle, code=v1.Code(bits=8, number=5))]
    snapshot = Snapshot(v1.Snapshot(objects=objects, pose_time_ns=7))
    assert snapshot.ids.tolist() == [3, 9]
    assert snapshot.positions_m.shape == (2, 3)
    assert snapshot.covariances is not None and snapshot.covariances.shape == (2, 6, 6)
    np.testing.assert_array_equal(snapshot.covariances, np.swapaxes(snapshot.covariances, 1, 2))
    robot = snapshot.robot(9)
    assert robot is not None
    assert (robot.code, robot.stage) == (5, LifeStage.TRACKED)
    assert robot.position_sigma_m is not None
    np.testing.assert_allclose(robot.position_sigma_m, [1.0, 2.0, 3.0])
    assert snapshot.robot(4) is None
    assert snapshot.robot(3).code is None  # type: ignore[union-attr]


def test_an_empty_snapshot_has_empty_arrays() -> None:
    snapshot = Snapshot(v1.Snapshot())
    assert len(snapshot) == 0
    for array, shape in [
        (snapshot.positions_m, (0, 3)),
        (snapshot.orientations, (0, 4)),
        (snapshot.rotations, (0, 3, 3)),
        (snapshot.covariances, (0, 6, 6)),
        (snapshot.predicted(0.1).positions_m, (0, 3)),
    ]:
        assert array is not None and array.shape == shape


def test_prediction_follows_velocity_fading_acceleration_and_turn() -> None:
    objects = [state(1), state(2, acceleration=v1.Vector3(x=0.0, y=2.0, z=0.0))]
    snapshot = Snapshot(v1.Snapshot(objects=objects, pose_time_ns=1_000_000_000))
    later = snapshot.predicted(0.5)
    assert later.pose_time_ns == 1_500_000_000
    assert later.covariances is None
    np.testing.assert_allclose(later.positions_m[0], [1.5, 2.0, 3.0])
    # The integral of a e^(-t/L), twice, by small steps.
    steps, dt = 50_000, 0.5 / 50_000
    t = (np.arange(steps) + 0.5) * dt
    faster = np.cumsum(2.0 * np.exp(-t / 0.4)) * dt
    np.testing.assert_allclose(later.velocities_m_s[1], [1.0, faster[-1], 0.0], rtol=1e-4)
    np.testing.assert_allclose(later.positions_m[1, 1], 2.0 + faster.sum() * dt, rtol=1e-4)
    # A quarter turn about z.
    np.testing.assert_allclose(later.rotations[0] @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-9)
    # In two halves as at once, and back.
    halves = snapshot.predicted(0.25).predicted(0.25)
    np.testing.assert_allclose(halves.positions_m, later.positions_m, atol=1e-12)
    back = later.predicted_to(snapshot.pose_time_ns)
    np.testing.assert_allclose(back.positions_m, snapshot.positions_m, atol=1e-12)
    np.testing.assert_allclose(back.orientations, snapshot.orientations, atol=1e-12)
    with pytest.raises(ValueError, match="finite"):
        snapshot.predicted(float("nan"))


def test_a_follower_counts_gaps_and_tells_a_new_server() -> None:
    follower = Follower()
    message = lambda sequence, source="a", missed=0: v1.Snapshot(sequence=sequence, source_id=source, missed=missed)  # noqa: E731
    assert [type(u) for u in follower.received(message(5))] == [Snapshot]
    follower.received(message(9, missed=3))
    assert follower.missed == 3
    gone = follower.lost(Unreachable("here", "reset"))
    assert (gone.reason, gone.tries) == ("reset", 0)
    assert follower.lost(Unreachable("here", "refused")).tries == 1
    back = follower.received(message(20))
    assert isinstance(back[0], Reconnected) and back[0].missed == 10
    assert isinstance(back[1], Snapshot) and follower.missed == 13
    follower.lost(Unreachable("here", "reset"))
    assert follower.received(message(1, source="b"))[0] == Reconnected(None)
    with pytest.raises(Refused):
        follower.lost(Refused("region: expected …", grpc.StatusCode.INVALID_ARGUMENT))
    assert isinstance(gone, Disconnected)


def test_the_quickest_probe_gives_the_offset() -> None:
    ahead, ms = 7_000_000_000, 1_000_000

    def probe(at: int, there: int, back: int) -> tuple[v1.ServerTime, int]:
        received = at + there + ahead
        answer = v1.ServerTime(sent_time_ns=at, received_time_ns=received, replied_time_ns=received + ms)
        return answer, at + there + ms + back

    found = best([probe(0, 9 * ms, ms), probe(100 * ms, ms, ms), probe(200 * ms, ms, 40 * ms)])
    assert found is not None and (found.offset_ns, found.round_trip_ns) == (ahead, 2 * ms)
    assert found.to_own_ns(found.to_server_ns(123)) == 123
    # The clock was set back meanwhile.
    assert best([(v1.ServerTime(sent_time_ns=10, received_time_ns=0, replied_time_ns=0), 5)]) is None


def test_every_call_of_the_service_is_there_with_its_answer() -> None:
    service = v1.Snapshot.DESCRIPTOR.file.pool.FindServiceByName("roundel.v1.Roundel")
    wanted = {method.name: method.output_type.name for method in service.methods}
    assert {call: answer.DESCRIPTOR.name for call, answer in ANSWERS.items()} == wanted


def test_who_was_second_is_told_to_read_again() -> None:
    class Aborted(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return grpc.StatusCode.ABORTED

        def details(self) -> str:
            return "the configuration has changed"

    error = from_rpc("http://a", Aborted())
    assert isinstance(error, Conflict) and not error.is_temporary
    assert str(error) == "somebody else was first: the configuration has changed"


def test_wrong_arguments_are_told_before_anything_is_sent() -> None:
    with pytest.raises(ValueError, match="corners of three numbers"):
        Subscription(region_m=((0, 0), (1, 1, 1))).request()
    with pytest.raises(ValueError, match="corners of three numbers"):
        history_request([], ((0, 0), (1, 1, 1)), (0, 0), 0)
    with pytest.raises(ValueError, match="two or three numbers"):
        drive_request({1: [0.5]})
    with pytest.raises(ValueError, match="if_sound"):
        calibration_request(None, False, "perhaps")


def test_a_subscription_is_the_message_that_asks_for_it() -> None:
    request = Subscription(
        ids=[2, 1], roundels=["robot"], region_m=((-1, -2, 0), (1, 2, float("inf"))), max_rate_hz=20, horizon_s=0.05,
        covariance=False,
    ).request()
    assert (list(request.object_ids), list(request.roundels)) == ([2, 1], ["robot"])
    assert (request.region.min.y, request.region.max.z) == (-2.0, float("inf"))
    assert (request.max_rate_hz, request.horizon_ms, request.omit_covariance) == (20.0, 50.0, True)
    assert not Subscription().request().HasField("max_rate_hz")
