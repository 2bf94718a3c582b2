"""Requests, response types and channel options, shared by both clients."""

from __future__ import annotations

import math
from typing import Any, Mapping, Sequence

from roundel import v1

MAX_MESSAGE_BYTES = 64 * 1024 * 1024
"""Limit for one message. A snapshot of 10,000 objects with covariances takes 5 MB."""

CONNECT_TIMEOUT_S = 5.0
DEFAULT_TIMEOUT_S = 15.0
LONG_TIMEOUT_S = 60.0
"""Default timeout of calls for which the server opens, writes or searches something."""

LONG_CALLS = frozenset({
    "TestSource", "AddCamera", "ChangeCamera", "RemoveCamera", "ApplyConfiguration", "StopRecording", "QueryHistory",
})  # fmt: skip

CHANNEL_OPTIONS: list[tuple[str, Any]] = [
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    # A growing flow-control window would buffer seconds of old snapshots for a slow reader.
    ("grpc.http2.bdp_probe", 0),
    # A snapshot of some hundred objects fits into one frame, which the server sends with one write.
    ("grpc.http2.max_frame_size", 64 * 1024),
    # Keep-alive: pings a silent server, and drops the connection without an answer.
    ("grpc.keepalive_time_ms", 5000),
    ("grpc.keepalive_timeout_ms", 5000),
    ("grpc.keepalive_permit_without_calls", 1),
    # One connection per client, with its own backoff.
    ("grpc.use_local_subchannel_pool", 1),
    ("grpc.initial_reconnect_backoff_ms", 100),
    # Despite its name, this is the timeout of one connection attempt.
    ("grpc.min_reconnect_backoff_ms", int(1000 * CONNECT_TIMEOUT_S)),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.enable_http_proxy", 0),
]

RESPONSES: dict[str, Any] = {
    "SubscribeSnapshots": v1.Snapshot,
    "SubscribeObservations": v1.FrameObservations,
    "GetObservations": v1.GetObservationsResponse,
    "SubscribeEvents": v1.Event,
    "TestSource": v1.SourceTest,
    "GetCameraSetup": v1.CameraSetup,
    "AddCamera": v1.CameraChange,
    "ChangeCamera": v1.CameraChange,
    "RemoveCamera": v1.CameraChange,
    "GetObjectSetup": v1.ObjectSetup,
    "AddObject": v1.ObjectChange,
    "ChangeObject": v1.ObjectChange,
    "RemoveObject": v1.ObjectChange,
    "NameObject": v1.ObjectChange,
    "GetConfiguration": v1.Configuration,
    "CheckConfiguration": v1.ConfigurationCheck,
    "ApplyConfiguration": v1.AppliedConfiguration,
    "GetSnapshot": v1.Snapshot,
    "ListCameras": v1.ListCamerasResponse,
    "ListObjects": v1.ListObjectsResponse,
    "ListPrintSizes": v1.ListPrintSizesResponse,
    "GetPicture": v1.CameraPicture,
    "GetServerInfo": v1.ServerInfo,
    "GetTime": v1.ServerTime,
    "DriveRobots": v1.DriveRobotsResponse,
    "PushRobot": v1.PushRobotResponse,
    "StartCalibration": v1.Calibration,
    "GetCalibration": v1.Calibration,
    "WatchCalibration": v1.Calibration,
    "CancelCalibration": v1.Calibration,
    "ApplyCalibration": v1.Calibration,
    "StartRecording": v1.Recording,
    "StopRecording": v1.Recording,
    "GetRecording": v1.Recording,
    "ListRecordings": v1.ListRecordingsResponse,
    "GetReplay": v1.Replay,
    "ControlReplay": v1.Replay,
    "QueryHistory": v1.QueryHistoryResponse,
}
"""Response type of each call."""


def checked_timeout_s(timeout_s: float | None) -> float | None:
    """Returns `timeout_s`; raises ValueError unless it is None or a positive number."""
    if timeout_s is not None and not 0.0 < timeout_s < math.inf:
        raise ValueError(f"timeout_s: expected seconds above 0, or None for the default, found {timeout_s}")
    return timeout_s


def call_timeout_s(call: str, timeout_s: float | None) -> float:
    """The timeout of a call of a client whose own timeout is `timeout_s`."""
    if timeout_s is not None:
        return timeout_s
    return LONG_TIMEOUT_S if call in LONG_CALLS else DEFAULT_TIMEOUT_S


def method_path(call: str) -> str:
    return f"/roundel.v1.Roundel/{call}"


def serialize(message: Any) -> bytes:
    data: bytes = message.SerializeToString()
    return data


def drive_request(velocities_m_s: Mapping[int, Sequence[float]]) -> v1.DriveRobotsRequest:
    robots = [v1.RobotDrive(object_id=i, velocity=vector(v)) for i, v in velocities_m_s.items()]
    return v1.DriveRobotsRequest(robots=robots)


def vector(values: Sequence[float]) -> v1.Vector3:
    """A vector of two or three numbers; z defaults to 0."""
    if len(values) not in (2, 3):
        raise ValueError(f"expected a velocity of two or three numbers, found {list(values)}")
    x, y, *rest = (float(value) for value in values)
    return v1.Vector3(x=x, y=y, z=rest[0] if rest else 0.0)


def calibration_request(seconds: float | None, refine_lenses: bool, apply: str) -> v1.StartCalibrationRequest:
    """`apply` is one of if_sound, always, never."""
    policies = {"if_sound", "always", "never"}
    if apply not in policies:
        raise ValueError(f"apply: expected one of {', '.join(sorted(policies))}, found {apply!r}")
    policy = f"CALIBRATION_APPLY_{apply.upper()}"
    return v1.StartCalibrationRequest(seconds=seconds, refine_lenses=refine_lenses, apply=policy)


def recording_request(name: str, frames_every: int | None, seconds: float | None) -> v1.StartRecordingRequest:
    """None stands for the configured value."""
    return v1.StartRecordingRequest(name=name, frames_every=frames_every, seconds=seconds)


def replay_request(
    paused: bool | None, speed: float | None, position_s: float | None, looping: bool | None
) -> v1.ControlReplayRequest:
    """None leaves a value unchanged."""
    request = v1.ControlReplayRequest(speed=speed, position_s=position_s)
    if paused is not None:
        request.paused = paused
    if looping is not None:
        request.looping = looping
    return request


def history_request(
    objects: Sequence[int | str],
    region_m: tuple[Sequence[float], Sequence[float]] | None,
    times_ns: tuple[int, int],
    max_points: int,
) -> v1.QueryHistoryRequest:
    """Objects by id, name or code. Times of 0 stand for the last hour until now."""
    from_ns, until_ns = times_ns
    return v1.QueryHistoryRequest(
        objects=[str(each) for each in objects],
        region=None if region_m is None else box(region_m),
        from_time_ns=from_ns,
        until_time_ns=until_ns,
        max_points=max_points,
    )


def box(corners_m: tuple[Sequence[float], Sequence[float]]) -> v1.Box:
    """The box between two corners, which may be infinite."""
    low, high = (_corner(corner) for corner in corners_m)
    return v1.Box(min=low, max=high)


def _corner(corner: Sequence[float]) -> v1.Vector3:
    if len(corner) != 3:
        raise ValueError(f"region_m: expected corners of three numbers, found {list(corner)}")
    x, y, z = corner
    return v1.Vector3(x=float(x), y=float(y), z=float(z))
