"""Unit tests without a server."""

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
    PermissionDenied,
    Reconnected,
    Refused,
    RoundelError,
    ServerError,
    Snapshot,
    Stale,
    Subscription,
    Track,
    Unauthenticated,
    Unreachable,
    v1,
)
from roundel._address import Address
from roundel._backoff import INITIAL_S, MAX_S, Backoff
from roundel._calls import LONG_CALLS, RESPONSES, call_timeout_s, calibration_request, drive_request, history_request
from roundel._stream_state import StreamState
from roundel.clock import best
from roundel.errors import from_rpc

import grpc


@pytest.mark.parametrize("address", ["127.0.0.1:7670", "http://127.0.0.1:7670", " http://127.0.0.1:7670/ "])
def test_the_scheme_of_an_address_is_optional(address: str) -> None:
    assert Address.parse(address).target == "127.0.0.1:7670"
    assert Address.parse("[::1]:7670").target == "[::1]:7670"


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("", "it is empty"),
        ("127.0.0.1", "the port is missing"),
        ("https://arena", "the port is missing"),
        ("ws://arena:7670", "ws:// is neither http:// nor https://"),
        ("http://arena:7670/api/v1", "unexpected /api/v1 after the port"),
        ("http://are na:7670", "space"),
        ("http://arena:99999", "ort"),
    ],
)
def test_invalid_addresses_raise_with_the_reason(address: str, reason: str) -> None:
    with pytest.raises(InvalidAddress, match=r"expected http://HOST:PORT") as caught:
        Address.parse(address)
    assert reason in str(caught.value)


def test_backoff_grows_to_the_cap_and_resets() -> None:
    backoff = Backoff()
    pauses = [backoff.next_pause_s() for _ in range(40)]
    assert INITIAL_S / 2 <= pauses[0] <= INITIAL_S
    assert all(MAX_S / 2 <= pause <= MAX_S for pause in pauses[8:])
    backoff.reset()
    assert backoff.next_pause_s() <= INITIAL_S


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
    # Upper triangle, row by row: 1, 4, 9, 16, 25, 36 on the diagonal, 0.5 elsewhere.
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


def test_prediction_uses_velocity_decaying_acceleration_and_angular_velocity() -> None:
    objects = [state(1), state(2, acceleration=v1.Vector3(x=0.0, y=2.0, z=0.0))]
    snapshot = Snapshot(v1.Snapshot(objects=objects, pose_time_ns=1_000_000_000))
    later = snapshot.predicted(0.5)
    assert later.pose_time_ns == 1_500_000_000
    assert later.covariances is None
    np.testing.assert_allclose(later.positions_m[0], [1.5, 2.0, 3.0])
    # Numerical double integral of a e^(-t/L).
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


def test_stream_state_counts_gaps_and_detects_restarts() -> None:
    now_s = 100.0
    state_machine = StreamState(lambda: now_s)
    message = lambda sequence, source="a", missed=0: v1.Snapshot(sequence=sequence, source_id=source, missed=missed)  # noqa: E731
    assert [type(u) for u in state_machine.received(message(5))] == [Snapshot]
    state_machine.received(message(9, missed=3))
    assert state_machine.missed == 3
    loss = state_machine.lost(Unreachable("here", "reset"))
    assert (loss.reason, loss.tries) == ("reset", 0)
    assert state_machine.lost(Unreachable("here", "refused")).tries == 1
    back = state_machine.received(message(20))
    assert isinstance(back[0], Reconnected) and back[0].missed == 10
    assert isinstance(back[1], Snapshot) and state_machine.missed == 13
    state_machine.lost(Unreachable("here", "reset"))
    now_s += 2.5
    assert state_machine.received(message(1, source="b"))[0] == Reconnected(None, True, 2.5)
    with pytest.raises(Refused):
        state_machine.lost(Refused("region: expected …", grpc.StatusCode.INVALID_ARGUMENT))
    assert isinstance(loss, Disconnected)


def test_link_reports_losses_but_no_reconnection_at_first_connection() -> None:
    now_s = 10.0
    state_machine = StreamState(lambda: now_s)
    assert state_machine.link == Link(LinkState.CONNECTING, None, 0, 0) and state_machine.age_s == float("inf")
    with pytest.raises(Stale, match="none has arrived yet; the connection is connecting"):
        state_machine.recent(None, 1.0)
    refused = Unreachable("here", "connection refused")
    state_machine.lost(refused)
    assert state_machine.link == Link(LinkState.CONNECTING, refused, 1, 0)
    (snapshot,) = state_machine.received(v1.Snapshot(sequence=5, source_id="a"))
    assert isinstance(snapshot, Snapshot)
    assert state_machine.link.is_up and state_machine.link.error is refused
    now_s += 0.5
    assert state_machine.age_s == 0.5 and state_machine.recent(snapshot, 0.5) is snapshot
    reset = Unreachable("here", "reset by peer")
    state_machine.lost(reset)
    assert state_machine.link == Link(LinkState.LOST, reset, 0, 1), "no attempt yet"
    with pytest.raises(Stale, match="newest arrived 0.50 s ago; the connection is lost: no answer from here: reset by peer") as stale:
        state_machine.recent(snapshot, 0.4)
    assert (stale.value.age_s, stale.value.link) == (0.5, state_machine.link)
    state_machine.lost(refused)
    assert state_machine.link == Link(LinkState.LOST, refused, 1, 1)
    assert isinstance(state_machine.received(v1.Snapshot(sequence=6, source_id="a"))[0], Reconnected)
    state_machine.end()
    assert state_machine.link.state is LinkState.ENDED


def test_a_server_without_http2_is_retried_where_a_roundel_server_was() -> None:
    class NoHttp2(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return grpc.StatusCode.UNAVAILABLE

        def details(self) -> str:
            return "failed to connect to all addresses; last error: INTERNAL: ipv4:127.0.0.1:80: Failed parsing HTTP/2 (…)"

    def failure() -> RoundelError:
        return from_rpc("http://a:9", NoHttp2())

    fresh = StreamState()
    with pytest.raises(NotRoundel, match="http://a:9 answers, but is not a Roundel server"):
        fresh.lost(failure())
    assert fresh.link.state is LinkState.ENDED
    state_machine = StreamState()
    state_machine.received(v1.Snapshot(sequence=5, source_id="a"))
    state_machine.lost(Unreachable("http://a:9", "reset"))
    update = state_machine.lost(failure())
    assert (update.reason, update.tries) == ("a server without HTTP/2 answers there", 1)
    assert state_machine.link.state is LinkState.LOST and isinstance(state_machine.link.error, Unreachable)
    assert isinstance(state_machine.received(v1.Snapshot(sequence=6, source_id="a"))[0], Reconnected)
    with pytest.raises(NotRoundel):
        state_machine.lost(NotRoundel("http://a:9", "it does not support this call"))


@pytest.mark.parametrize("logs", [True, False])
def test_losses_are_logged_on_request(logs: bool, caplog: pytest.LogCaptureFixture) -> None:
    state_machine = StreamState(logs=logs)
    state_machine.received(v1.Snapshot(sequence=1, source_id="a"))
    state_machine.lost(Unreachable("here", "reset by peer"))
    state_machine.received(v1.Snapshot(sequence=4, source_id="a"))
    logged = [record.getMessage().split(";")[0].split(" after")[0] for record in caplog.records]
    assert logged == (["connection lost: reset by peer", "connected again"] if logs else [])


def test_history_is_given_as_arrays() -> None:
    points = [v1.HistoryPoint(time_ns=t, position=v1.Vector3(x=t, y=2.0, z=3.0)) for t in (10, 20)]
    points[1].yaw_rad = 0.5
    old = v1.ObjectHistory(object_id=4, name="carrier", source_id="a", points=points[:1])
    new = v1.ObjectHistory(object_id=1, name="carrier", source_id="b", code=12, points=points)
    history = History(v1.QueryHistoryResponse(objects=[old, new], step_s=0.1, oldest_time_ns=5, newest_time_ns=25))
    track = history.track("carrier")
    assert track is history.tracks[1] and history.track(4) is history.tracks[0] and history.track("missing") is None
    assert (track.source_id, track.code, history.tracks[0].code, len(track)) == ("b", 12, None, 2)
    assert track.times_ns.tolist() == [10, 20] and track.times_ns.dtype == np.int64
    np.testing.assert_array_equal(track.positions_m, [[10.0, 2.0, 3.0], [20.0, 2.0, 3.0]])
    np.testing.assert_array_equal(track.yaws_rad, [np.nan, 0.5])
    assert (history.step_s, history.kept_ns) == (0.1, (5, 25))
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
    assert snapshot.robot("missing") is None and snapshot.coded(6) is None and snapshot.position_m("missing") is None
    assert carrier.yaw_rad == pytest.approx(np.pi / 2) and coded.yaw_rad is None
    assert carrier.speed_m_s == 1.0
    np.testing.assert_array_equal(snapshot.position_m(9), [1.0, 2.0, 3.0])
    assert snapshot.codes == [None, 5] and snapshot.tracked.tolist() == [True, False]
    # NumPy integers are accepted.
    assert snapshot.robot(snapshot.ids[1]).object_id == 9  # type: ignore[arg-type]
    # An empty name matches no object.
    assert snapshot.robot("") is None


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_timeouts_are_rejected(wrong: float) -> None:
    with pytest.raises(ValueError, match="timeout_s: expected seconds above 0"):
        Client("http://127.0.0.1:9", timeout_s=wrong)


def test_slow_calls_have_a_longer_default_timeout() -> None:
    assert call_timeout_s("GetSnapshot", None) == 15.0 < call_timeout_s("TestSource", None) < float("inf")
    assert call_timeout_s("TestSource", 0.5) == 0.5
    assert LONG_CALLS <= RESPONSES.keys()


def test_the_probe_with_the_shortest_round_trip_gives_the_offset() -> None:
    ahead, ms = 7_000_000_000, 1_000_000

    def probe(at: int, there: int, back: int) -> tuple[v1.ServerTime, int]:
        received = at + there + ahead
        answer = v1.ServerTime(sent_time_ns=at, received_time_ns=received, replied_time_ns=received + ms)
        return answer, at + there + ms + back

    found = best([probe(0, 9 * ms, ms), probe(100 * ms, ms, ms), probe(200 * ms, ms, 40 * ms)])
    assert found is not None and (found.offset_ns, found.round_trip_ns) == (ahead, 2 * ms)
    assert found.to_own_ns(found.to_server_ns(123)) == 123
    # The clock was set back during the probe.
    assert best([(v1.ServerTime(sent_time_ns=10, received_time_ns=0, replied_time_ns=0), 5)]) is None


def test_every_call_of_the_service_has_its_response_type() -> None:
    service = v1.Snapshot.DESCRIPTOR.file.pool.FindServiceByName("roundel.v1.Roundel")
    expected = {method.name: method.output_type.name for method in service.methods}
    assert {call: response.DESCRIPTOR.name for call, response in RESPONSES.items()} == expected


def test_an_aborted_call_is_a_conflict() -> None:
    class Aborted(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return grpc.StatusCode.ABORTED

        def details(self) -> str:
            return "the configuration has changed"

    error = from_rpc("http://a", Aborted())
    assert isinstance(error, Conflict) and not error.is_temporary
    assert str(error) == "conflict with another change: the configuration has changed"


@pytest.mark.parametrize(
    ("details", "expected"),
    [
        (
            "failed to connect to all addresses; last error: UNKNOWN: ipv4:127.0.0.1:9: Failed to connect to remote host: "
            "Connection refused",
            "no answer from http://a:9: Connection refused; check the address",
        ),
        ("errors resolving a:9: [field:hostname lookup error: …]", "cannot resolve the host name a"),
        ("server is shutting down", "no answer from http://a:9: server is shutting down; "),
        (
            "failed to connect to all addresses; last error: UNAVAILABLE: ipv4:127.0.0.1:80: Failed parsing HTTP/2 (Expected …)",
            "http://a:9 answers, but is not a Roundel server, or is an older version: it does not speak HTTP/2",
        ),
    ],
)
def test_network_errors_omit_the_layers_of_grpc(details: str, expected: str) -> None:
    class Unavailable(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return grpc.StatusCode.UNAVAILABLE

        def details(self) -> str:
            return message

    message = details
    assert expected in str(from_rpc("http://a:9", Unavailable()))


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (grpc.StatusCode.INVALID_ARGUMENT, Refused),
        (grpc.StatusCode.NOT_FOUND, Refused),
        (grpc.StatusCode.OUT_OF_RANGE, Refused),
        (grpc.StatusCode.FAILED_PRECONDITION, Refused),
        (grpc.StatusCode.PERMISSION_DENIED, PermissionDenied),
        (grpc.StatusCode.UNAUTHENTICATED, Unauthenticated),
        (grpc.StatusCode.ABORTED, Conflict),
        (grpc.StatusCode.UNIMPLEMENTED, NotRoundel),
        (grpc.StatusCode.UNAVAILABLE, ServerError),
        (grpc.StatusCode.RESOURCE_EXHAUSTED, ServerError),
        (grpc.StatusCode.INTERNAL, ServerError),
    ],
)
def test_status_codes_map_to_the_same_errors_as_in_rust(code: grpc.StatusCode, kind: type[RoundelError]) -> None:
    class StatusError(grpc.RpcError):
        def code(self) -> grpc.StatusCode:
            return code

        def details(self) -> str:
            return "message of the server"

        def trailing_metadata(self) -> Any:
            return (("grpc-status-details-bin", b""),)

    error = from_rpc("http://a", StatusError())
    assert type(error) is kind and "message of the server" in str(error)
    assert error.is_temporary == (kind is ServerError)


def test_invalid_arguments_raise_before_a_call() -> None:
    with pytest.raises(ValueError, match="corners of three numbers"):
        Subscription(region_m=((0, 0), (1, 1, 1))).request()
    with pytest.raises(ValueError, match="corners of three numbers"):
        history_request([], ((0, 0), (1, 1, 1)), (0, 0), 0)
    with pytest.raises(ValueError, match="two or three numbers"):
        drive_request({1: [0.5]})
    with pytest.raises(ValueError, match="if_sound"):
        calibration_request(None, False, "perhaps")


def test_a_subscription_becomes_a_request() -> None:
    request = Subscription(
        ids=[2, 1], roundels=["robot"], region_m=((-1, -2, 0), (1, 2, float("inf"))), max_rate_hz=20, horizon_s=0.05,
        covariance=False,
    ).request()
    assert (list(request.object_ids), list(request.roundels)) == ([2, 1], ["robot"])
    assert (request.region.min.y, request.region.max.z) == (-2.0, float("inf"))
    assert (request.max_rate_hz, request.horizon_ms, request.omit_covariance) == (20.0, 50.0, True)
    assert not Subscription().request().HasField("max_rate_hz")
    selection = Subscription(ids=np.array([3]), names=["cart"], codes=[12, v1.Code(bits=8, number=5)], horizon_s=0.1)  # type: ignore[arg-type]
    for request in (selection.request(), selection.single_request()):
        assert (list(request.object_ids), list(request.names), request.horizon_ms) == ([3], ["cart"], 100.0)
        assert [(code.bits, code.number) for code in request.codes] == [(0, 12), (8, 5)]
    with pytest.raises(ValueError, match=r"names: expected a list of names, found 'cart'; one is \['cart'\]"):
        Subscription(names="cart").request()
    with pytest.raises(ValueError, match="a single snapshot has no rate"):
        Subscription(max_rate_hz=5.0).single_request()


@pytest.mark.parametrize(
    ("field", "invalid", "reason"),
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
def test_a_subscription_names_the_invalid_number(field: str, invalid: object, reason: str) -> None:
    subscription = Subscription(**{field: [3, invalid]})  # type: ignore[arg-type]
    for request in (subscription.request, subscription.single_request):
        with pytest.raises(ValueError) as error:
            request()
        assert str(error.value) == reason
