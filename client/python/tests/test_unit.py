"""What needs no server."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from roundel import (
    Client,
    Conflict,
    Disconnected,
    History,
    InvalidAddress,
    LifeStage,
    Link,
    LinkState,
    NotRoundel,
    Reconnected,
    Refused,
    RoundelError,
    ServerError,
    Snapshot,
    Stale,
    Subscription,
    Track,
    Unreachable,
    v1,
)
from roundel._address import target
from roundel._backoff import FIRST_S, LONGEST_S, Backoff
from roundel._calls import ANSWERS, LONG_CALLS, calibration_request, deadline_s, drive_request, history_request
from roundel._stream_state import StreamState
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
    now_s = 100.0
    follower = StreamState(lambda: now_s)
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
    now_s += 2.5
    assert follower.received(message(1, source="b"))[0] == Reconnected(None, True, 2.5)
    with pytest.raises(Refused):
        follower.lost(Refused("region: expected …", grpc.StatusCode.INVALID_ARGUMENT))
    assert isinstance(gone, Disconnected)


def test_a_link_tells_what_became_of_it_and_the_first_connection_is_none_that_is_back() -> None:
    now_s = 10.0
    follower = StreamState(lambda: now_s)
    assert follower.link == Link(LinkState.CONNECTING, None, 0, 0) and follower.age_s == float("inf")
    with pytest.raises(Stale, match="none has come yet; the connection is connecting"):
        follower.recent(None, 1.0)
    refused = Unreachable("here", "nobody listens")
    follower.lost(refused)
    assert follower.link == Link(LinkState.CONNECTING, refused, 1, 0)
    (snapshot,) = follower.received(v1.Snapshot(sequence=5, source_id="a"))
    assert isinstance(snapshot, Snapshot)
    assert follower.link.is_up and follower.link.error is refused
    now_s += 0.5
    assert follower.age_s == 0.5 and follower.recent(snapshot, 0.5) is snapshot
    reset = Unreachable("here", "reset by peer")
    follower.lost(reset)
    assert follower.link == Link(LinkState.LOST, reset, 0, 1), "nothing was tried yet"
    with pytest.raises(Stale, match="newest came 0.50 s ago; the connection is lost: no answer from here: reset by peer") as stale:
        follower.recent(snapshot, 0.4)
    assert (stale.value.age_s, stale.value.link) == (0.5, follower.link)
    follower.lost(refused)
    assert follower.link == Link(LinkState.LOST, refused, 1, 1)
    assert isinstance(follower.received(v1.Snapshot(sequence=6, source_id="a"))[0], Reconnected)
    follower.end()
    assert follower.link.state is LinkState.ENDED


def test_who_speaks_no_http2_is_asked_again_where_a_server_was() -> None:
    class NoHttp2(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return grpc.StatusCode.UNAVAILABLE

        def details(self) -> str:
            return "failed to connect to all addresses; last error: INTERNAL: ipv4:127.0.0.1:80: Failed parsing HTTP/2 (…)"

    def failure() -> RoundelError:
        return from_rpc("http://a:9", NoHttp2())

    nobodys = StreamState()
    with pytest.raises(NotRoundel, match="http://a:9 answers, but is no Roundel server"):
        nobodys.lost(failure())
    assert nobodys.link.state is LinkState.ENDED
    follower = StreamState()
    follower.received(v1.Snapshot(sequence=5, source_id="a"))
    follower.lost(Unreachable("http://a:9", "reset"))
    word = follower.lost(failure())
    assert (word.reason, word.tries) == ("what answers there speaks no HTTP/2", 1)
    assert follower.link.state is LinkState.LOST and isinstance(follower.link.error, Unreachable)
    assert isinstance(follower.received(v1.Snapshot(sequence=6, source_id="a"))[0], Reconnected)
    with pytest.raises(NotRoundel):
        follower.lost(NotRoundel("http://a:9", "it does not know this call"))


@pytest.mark.parametrize("logs", [True, False])
def test_losses_are_logged_where_nobody_else_tells_of_them(logs: bool, caplog: pytest.LogCaptureFixture) -> None:
    follower = StreamState(logs=logs)
    follower.received(v1.Snapshot(sequence=1, source_id="a"))
    follower.lost(Unreachable("here", "reset by peer"))
    follower.received(v1.Snapshot(sequence=4, source_id="a"))
    said = [record.getMessage().split(";")[0].split(" after")[0] for record in caplog.records]
    assert said == (["connection lost: reset by peer", "connected again"] if logs else [])


def test_the_past_comes_as_arrays() -> None:
    points = [v1.HistoryPoint(time_ns=t, position=v1.Vector3(x=t, y=2.0, z=3.0)) for t in (10, 20)]
    points[1].yaw_rad = 0.5
    old = v1.ObjectHistory(object_id=4, name="carrier", source_id="a", points=points[:1])
    new = v1.ObjectHistory(object_id=1, name="carrier", source_id="b", code=12, points=points)
    past = History(v1.QueryHistoryResponse(objects=[old, new], step_s=0.1, oldest_time_ns=5, newest_time_ns=25))
    track = past.track("carrier")
    assert track is past.tracks[1] and past.track(4) is past.tracks[0] and past.track("nobody") is None
    assert (track.source_id, track.code, past.tracks[0].code, len(track)) == ("b", 12, None, 2)
    assert track.times_ns.tolist() == [10, 20] and track.times_ns.dtype == np.int64
    np.testing.assert_array_equal(track.positions_m, [[10.0, 2.0, 3.0], [20.0, 2.0, 3.0]])
    np.testing.assert_array_equal(track.yaws_rad, [np.nan, 0.5])
    assert (past.step_s, past.kept_ns) == (0.1, (5, 25))
    empty = Track(v1.ObjectHistory())
    assert empty.positions_m.shape == (0, 3) and History(v1.QueryHistoryResponse()).tracks == []


def test_robots_are_found_by_id_name_and_code() -> None:
    quarter = v1.Quaternion(z=np.sqrt(0.5), w=np.sqrt(0.5))
    objects = [state(3, name="carrier", yaw_observed=True), state(9, code=v1.Code(bits=8, number=5))]
    objects[0].orientation.CopyFrom(quarter)
    objects[1].stage = v1.LIFE_STAGE_PREDICTED
    snapshot = Snapshot(v1.Snapshot(objects=objects))
    carrier, coded = snapshot.robot("carrier"), snapshot.coded(5)
    assert carrier is not None and coded is not None
    assert (carrier.object_id, coded.object_id) == (3, 9)
    assert snapshot.robot("nobody") is None and snapshot.coded(6) is None and snapshot.position_m("nobody") is None
    assert carrier.yaw_rad == pytest.approx(np.pi / 2) and coded.yaw_rad is None
    assert carrier.speed_m_s == 1.0
    np.testing.assert_array_equal(snapshot.position_m(9), [1.0, 2.0, 3.0])
    assert snapshot.codes == [None, 5] and snapshot.tracked.tolist() == [True, False]
    # As NumPy has it.
    assert snapshot.robot(snapshot.ids[1]).object_id == 9  # type: ignore[arg-type]
    # Nobody's name is empty: an object without one is not found by it.
    assert snapshot.robot("") is None


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_a_timeout_by_which_no_call_can_end_is_refused(wrong: float) -> None:
    with pytest.raises(ValueError, match="timeout_s: expected seconds above 0"):
        Client("http://127.0.0.1:9", timeout_s=wrong)


def test_calls_that_take_longer_may() -> None:
    assert deadline_s("GetSnapshot", None) == 15.0 < deadline_s("TestSource", None) < float("inf")
    assert deadline_s("TestSource", 0.5) == 0.5
    assert LONG_CALLS <= ANSWERS.keys()


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


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (
            "failed to connect to all addresses; last error: UNKNOWN: ipv4:127.0.0.1:9: Failed to connect to remote host: "
            "Connection refused",
            "no answer from http://a:9: Connection refused; check the address",
        ),
        ("errors resolving a:9: [field:hostname lookup error: …]", "no machine of the name a is known here"),
        ("server is shutting down", "no answer from http://a:9: server is shutting down; "),
        (
            "failed to connect to all addresses; last error: UNAVAILABLE: ipv4:127.0.0.1:80: Failed parsing HTTP/2 (Expected …)",
            "http://a:9 answers, but is no Roundel server, or an older one: it speaks no HTTP/2",
        ),
    ],
)
def test_what_the_network_says_is_told_without_its_layers(said: str, told: str) -> None:
    class Unavailable(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return grpc.StatusCode.UNAVAILABLE

        def details(self) -> str:
            return said

    assert told in str(from_rpc("http://a:9", Unavailable()))


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (grpc.StatusCode.INVALID_ARGUMENT, Refused),
        (grpc.StatusCode.NOT_FOUND, Refused),
        (grpc.StatusCode.OUT_OF_RANGE, Refused),
        (grpc.StatusCode.FAILED_PRECONDITION, Refused),
        (grpc.StatusCode.PERMISSION_DENIED, Refused),
        (grpc.StatusCode.ABORTED, Conflict),
        (grpc.StatusCode.UNIMPLEMENTED, NotRoundel),
        (grpc.StatusCode.UNAVAILABLE, ServerError),
        (grpc.StatusCode.RESOURCE_EXHAUSTED, ServerError),
        (grpc.StatusCode.INTERNAL, ServerError),
    ],
)
def test_what_a_server_says_means_the_same_as_in_rust(code: grpc.StatusCode, kind: type[RoundelError]) -> None:
    class Said(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return code

        def details(self) -> str:
            return "said by the server"

        def trailing_metadata(self) -> Any:
            return (("grpc-status-details-bin", b""),)

    error = from_rpc("http://a", Said())
    assert type(error) is kind and "said by the server" in str(error)
    assert error.is_temporary == (kind is ServerError)


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
    chosen = Subscription(ids=np.array([3]), names=["cart"], codes=[12, v1.Code(bits=8, number=5)], horizon_s=0.1)  # type: ignore[arg-type]
    for asked in (chosen.request(), chosen.single_request()):
        assert (list(asked.object_ids), list(asked.names), asked.horizon_ms) == ([3], ["cart"], 100.0)
        assert [(code.bits, code.number) for code in asked.codes] == [(0, 12), (8, 5)]
    with pytest.raises(ValueError, match=r"names: expected a list of names, found 'cart'; one is \['cart'\]"):
        Subscription(names="cart").request()
    with pytest.raises(ValueError, match="a single snapshot has no rate"):
        Subscription(max_rate_hz=5.0).single_request()


@pytest.mark.parametrize(
    ("field", "wrong", "why"),
    [
        ("ids", -1, "ids: expected whole numbers from 0 (object_id), found -1"),
        ("ids", "x", "ids: expected whole numbers from 0 (object_id), found 'x'"),
        ("ids", 3.7, "ids: expected whole numbers from 0 (object_id), found 3.7"),
        ("ids", 2**64, f"ids: expected whole numbers below 2^64 (object_id), found {2**64}"),
        ("codes", -1, "codes: expected whole numbers from 0 (number of a code), found -1"),
        ("codes", "x", "codes: expected whole numbers from 0 (number of a code), found 'x'"),
        ("codes", 2**32, f"codes: expected whole numbers below 2^32 (number of a code), found {2**32}"),
    ],
)
def test_a_subscription_says_which_number_is_none(field: str, wrong: object, why: str) -> None:
    subscription = Subscription(**{field: [3, wrong]})  # type: ignore[arg-type]
    for request in (subscription.request, subscription.single_request):
        with pytest.raises(ValueError) as told:
            request()
        assert str(told.value) == why
