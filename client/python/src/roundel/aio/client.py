"""The connection to a server and its calls."""

from __future__ import annotations

import copy
import time
import weakref
from types import TracebackType
from typing import Any, AsyncIterator, Mapping, Sequence

import grpc

from roundel import _calls, clock, v1
from roundel._concurrency import AsyncChannel, AsyncEvent, AsyncLock, AsyncMessages
from roundel._trust import PathLike, Trust
from roundel.errors import Closed, ServerError, from_rpc
from roundel.history import History
from roundel.snapshot import Snapshot
from roundel.subscription import Subscription

from ._snapshots import Latest, Snapshots

__all__ = ["Client", "Latest", "Snapshots"]


class Client:
    """A connection to a server, restored automatically when it is lost.

    Calls raise the errors of :mod:`roundel.errors`. Once the client is closed, calls raise `Closed` and streams end.
    """

    def __init__(
        self,
        address: str = "http://127.0.0.1:7670",
        timeout_s: float | None = None,
        *,
        ca: PathLike | None = None,
        fingerprint: str | None = None,
        token: str | None = None,
        certificate: tuple[PathLike, PathLike] | None = None,
    ) -> None:
        """Sends nothing yet, so the server may come up later.

        A call that takes longer than `timeout_s` raises `TimedOut`. None stands for 15 s, or 60 s for calls for which
        the server opens, writes or searches something. Streams have no timeout. See also :meth:`within`.

        For an address with `https://`: `ca` is a PEM file of trusted authorities instead of the system's; `fingerprint`
        is the SHA-256 of the only trusted certificate, which the server prints at start; `certificate` has the PEM files
        of a client certificate and its key. `token` is sent with every call.
        """
        self.address = address
        self.timeout_s = _calls.checked_timeout_s(timeout_s)
        self._closed = AsyncEvent()
        self._channel = AsyncChannel(Trust.of(address, ca, fingerprint, token, certificate), self._closed)
        self._streams: weakref.WeakSet[Snapshots] = weakref.WeakSet()
        self._streams_lock = AsyncLock()

    @classmethod
    async def connect(
        cls,
        address: str = "http://127.0.0.1:7670",
        timeout_s: float | None = None,
        *,
        ca: PathLike | None = None,
        fingerprint: str | None = None,
        token: str | None = None,
        certificate: tuple[PathLike, PathLike] | None = None,
    ) -> Client:
        """Creates a client and checks that a Roundel server answers."""
        client = cls(address, timeout_s, ca=ca, fingerprint=fingerprint, token=token, certificate=certificate)
        try:
            await client.info(timeout_s=_calls.CONNECT_TIMEOUT_S if timeout_s is None else timeout_s)
        except BaseException:
            # Also when interrupted or cancelled: the caller never gets this client.
            await client.close()
            raise
        return client

    def within(self, timeout_s: float) -> Client:
        """This client over the same connection with another timeout, such as ``client.within(0.2)``."""
        other = copy.copy(self)
        other.timeout_s = _calls.checked_timeout_s(timeout_s)
        return other

    async def close(self) -> None:
        """Ends the connection and every stream over it at once."""
        with self._streams_lock:
            self._closed.set()
            streams = list(self._streams)
        for stream in streams:
            stream.close()
        await self._channel.close()

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # Snapshots

    def updates(self, subscription: Subscription | None = None) -> Snapshots:
        """Every snapshot from the newest on, and updates about lost and restored connections. Reconnects automatically."""
        return Snapshots(self, subscription or Subscription())

    async def snapshots(self, subscription: Subscription | None = None) -> AsyncIterator[Snapshot]:
        """Every snapshot from the newest on. Reconnects automatically and logs that (logger ``roundel``)."""
        async with Snapshots(self, subscription or Subscription(), logs=True) as updates:
            async for update in updates:
                if isinstance(update, Snapshot):
                    yield update

    def latest(self, subscription: Subscription | None = None) -> Latest:
        """The newest snapshot at any time, for loops that run at their own rate."""
        return Latest(self, subscription or Subscription())

    async def snapshot(self, subscription: Subscription | None = None) -> Snapshot:
        """The newest snapshot, once."""
        request = (subscription or Subscription()).single_request()
        return Snapshot(await self._call("GetSnapshot", request))

    # State of the server

    async def info(self, timeout_s: float | None = None) -> v1.ServerInfo:
        """Name, version and state of the server."""
        return await self._call("GetServerInfo", v1.GetServerInfoRequest(), timeout_s)  # type: ignore[no-any-return]

    async def objects(self) -> list[v1.Object]:
        """Every current object and those of the last minute, by id."""
        response = await self._call("ListObjects", v1.ListObjectsRequest())
        return list(response.objects)

    async def cameras(self) -> list[v1.Camera]:
        """Every camera, in the order of the configuration."""
        response = await self._call("ListCameras", v1.ListCamerasRequest())
        return list(response.cameras)

    def events(self, backlog: int = 0) -> AsyncIterator[v1.Event]:
        """The newest `backlog` remembered events, then every new one. Raises an error when the connection is lost."""
        return self._stream("SubscribeEvents", v1.SubscribeEventsRequest(backlog=backlog))

    def observations(self, cameras: Sequence[str] = ()) -> AsyncIterator[v1.FrameObservations]:
        """Observations of these cameras, or of all, frame by frame. Raises an error when the connection is lost."""
        request = v1.SubscribeObservationsRequest(cameras=list(cameras))
        return self._stream("SubscribeObservations", request)

    async def newest_observations(self, cameras: Sequence[str] = ()) -> list[v1.FrameObservations]:
        """Observations in the newest frames of these cameras, or of all, once."""
        response = await self._call("GetObservations", v1.GetObservationsRequest(cameras=list(cameras)))
        return list(response.frames)

    async def picture(self, camera: str) -> v1.CameraPicture:
        """A camera's picture as a JPEG file with the detections drawn in. Waits up to a second for a new frame."""
        return await self._call("GetPicture", v1.GetPictureRequest(camera=camera))  # type: ignore[no-any-return]

    async def clock_offset(self, probes: int = clock.PROBES) -> clock.ClockOffset:
        """How far the server's clock is ahead of this machine's."""
        answers = []
        for _ in range(probes):
            answer = await self._call("GetTime", v1.GetTimeRequest(sent_time_ns=time.time_ns()))
            answers.append((answer, time.time_ns()))
        found = clock.best(answers)
        if found is None:
            raise ServerError("no clock probe is plausible: a clock was set during the measurement", grpc.StatusCode.ABORTED)
        return found

    # Simulated robots

    async def drive(self, velocities_m_s: Mapping[int, Sequence[float]]) -> int:
        """Sets the velocities of simulated robots, by object_id, for half a second. Returns the server time of effect, ns."""
        response = await self._call("DriveRobots", _calls.drive_request(velocities_m_s))
        return int(response.effective_time_ns)

    async def push(self, object_id: int, velocity_m_s: Sequence[float], duration_s: float) -> int:
        """Pushes a simulated robot, regardless of its commanded velocity. Returns the server time of effect, ns."""
        velocity = _calls.vector(velocity_m_s)
        request = v1.PushRobotRequest(object_id=object_id, velocity=velocity, duration_ms=duration_s * 1e3)
        response = await self._call("PushRobot", request)
        return int(response.effective_time_ns)

    # Calibration and configuration

    async def start_calibration(
        self, seconds: float | None = None, refine_lenses: bool = False, apply: str = "if_sound"
    ) -> v1.Calibration:
        """Starts a calibration of the arena; `apply` is one of if_sound, always, never."""
        request = _calls.calibration_request(seconds, refine_lenses, apply)
        return await self._call("StartCalibration", request)  # type: ignore[no-any-return]

    async def calibration(self) -> v1.Calibration:
        """The newest calibration."""
        return await self._call("GetCalibration", v1.GetCalibrationRequest())  # type: ignore[no-any-return]

    def watch_calibration(self) -> AsyncIterator[v1.Calibration]:
        """The newest calibration and each change of it."""
        return self._stream("WatchCalibration", v1.WatchCalibrationRequest())

    async def cancel_calibration(self) -> v1.Calibration:
        """Ends the running calibration without a result."""
        return await self._call("CancelCalibration", v1.CancelCalibrationRequest())  # type: ignore[no-any-return]

    async def apply_calibration(self) -> v1.Calibration:
        """Applies the result of the newest calibration to the cameras."""
        return await self._call("ApplyCalibration", v1.ApplyCalibrationRequest())  # type: ignore[no-any-return]

    async def test_source(self, source: str, width: int = 0, height: int = 0) -> v1.SourceTest:
        """Has the server open a source for about two seconds and report the frames it gives."""
        request = v1.TestSourceRequest(source=source, width=width, height=height)
        return await self._call("TestSource", request)  # type: ignore[no-any-return]

    async def camera_setup(self, name: str) -> v1.CameraSetup:
        """A camera's entry in the server's configuration."""
        return await self._call("GetCameraSetup", v1.GetCameraSetupRequest(name=name))  # type: ignore[no-any-return]

    async def add_camera(self, camera: v1.CameraSetup) -> v1.CameraChange:
        """Adds a camera to the running server."""
        return await self._call("AddCamera", v1.AddCameraRequest(camera=camera))  # type: ignore[no-any-return]

    async def change_camera(self, name: str, camera: v1.CameraSetup, fields: Sequence[str]) -> v1.CameraChange:
        """Changes these fields of a camera; removes those that are absent in `camera`."""
        request = v1.ChangeCameraRequest(name=name, camera=camera, fields=list(fields))
        return await self._call("ChangeCamera", request)  # type: ignore[no-any-return]

    async def remove_camera(self, name: str) -> v1.CameraChange:
        """Removes a camera from the running server."""
        return await self._call("RemoveCamera", v1.RemoveCameraRequest(name=name))  # type: ignore[no-any-return]

    async def object_setup(self, name: str) -> v1.ObjectSetup:
        """An object's entry in the server's configuration."""
        return await self._call("GetObjectSetup", v1.GetObjectSetupRequest(name=name))  # type: ignore[no-any-return]

    async def add_object(self, object: v1.ObjectSetup) -> v1.ObjectChange:
        """Adds an object to the running server."""
        return await self._call("AddObject", v1.AddObjectRequest(object=object))  # type: ignore[no-any-return]

    async def change_object(self, name: str, object: v1.ObjectSetup, fields: Sequence[str]) -> v1.ObjectChange:
        """Changes these fields of an object; removes those that are absent in `object`."""
        request = v1.ChangeObjectRequest(name=name, object=object, fields=list(fields))
        return await self._call("ChangeObject", request)  # type: ignore[no-any-return]

    async def remove_object(self, name: str) -> v1.ObjectChange:
        """Removes an object from the running server. An object with a code stays tracked, without a name."""
        return await self._call("RemoveObject", v1.RemoveObjectRequest(name=name))  # type: ignore[no-any-return]

    async def name_object(self, object_id: int, name: str) -> v1.ObjectChange:
        """Names a tracked object permanently: by its code, or because it is the only one of its kind of roundel."""
        return await self._call("NameObject", v1.NameObjectRequest(object_id=object_id, name=name))  # type: ignore[no-any-return]

    async def configuration(self) -> v1.Configuration:
        """The current configuration, as text and as message."""
        return await self._call("GetConfiguration", v1.GetConfigurationRequest())  # type: ignore[no-any-return]

    async def check_configuration(self, toml: str) -> v1.ConfigurationCheck:
        """The errors of a configuration, or what applying it would change. Changes nothing."""
        return await self._call("CheckConfiguration", v1.CheckConfigurationRequest(toml=toml))  # type: ignore[no-any-return]

    async def apply_configuration(self, toml: str, version: str = "") -> v1.AppliedConfiguration:
        """Replaces the current configuration if it still has this version; empty: any version."""
        request = v1.ApplyConfigurationRequest(toml=toml, version=version)
        return await self._call("ApplyConfiguration", request)  # type: ignore[no-any-return]

    # Recordings and history

    async def start_recording(
        self, name: str = "", frames_every: int | None = None, seconds: float | None = None
    ) -> v1.Recording:
        """Starts a recording into files on the server. Keeps every `frames_every`-th frame as a picture; 0: none."""
        return await self._call("StartRecording", _calls.recording_request(name, frames_every, seconds))  # type: ignore[no-any-return]

    async def stop_recording(self) -> v1.Recording:
        """Ends the recording. Its files are complete on return."""
        return await self._call("StopRecording", v1.StopRecordingRequest())  # type: ignore[no-any-return]

    async def recording(self) -> v1.Recording:
        """The current recording, or the last one."""
        return await self._call("GetRecording", v1.GetRecordingRequest())  # type: ignore[no-any-return]

    async def recordings(self) -> list[v1.RecordingFile]:
        """The recordings in the server's folder, oldest first."""
        response = await self._call("ListRecordings", v1.ListRecordingsRequest())
        return list(response.files)

    async def replay(self) -> v1.Replay:
        """The recording that ``roundel replay`` plays, and its position."""
        return await self._call("GetReplay", v1.GetReplayRequest())  # type: ignore[no-any-return]

    async def control_replay(
        self,
        paused: bool | None = None,
        speed: float | None = None,
        position_s: float | None = None,
        looping: bool | None = None,
    ) -> v1.Replay:
        """Pauses, resumes or seeks the replay, or changes its speed. None leaves a value unchanged."""
        request = _calls.replay_request(paused, speed, position_s, looping)
        return await self._call("ControlReplay", request)  # type: ignore[no-any-return]

    async def history(
        self,
        objects: Sequence[int | str] = (),
        region_m: tuple[Sequence[float], Sequence[float]] | None = None,
        from_ns: int = 0,
        until_ns: int = 0,
        max_points: int = 0,
    ) -> History:
        """Past positions of objects (by id, name or code; empty: all). Times of 0 stand for the last hour until now."""
        request = _calls.history_request(objects, region_m, (from_ns, until_ns), max_points)
        return History(await self._call("QueryHistory", request))

    async def _call(self, call: str, request: Any, timeout_s: float | None = None) -> Any:
        if timeout_s is None:
            timeout_s = _calls.call_timeout_s(call, self.timeout_s)
        try:
            return await self._channel.unary(call, request, timeout_s)
        except grpc.RpcError as error:
            raise from_rpc(self.address, error, call, timeout_s) from error

    async def _open(self, call: str, request: Any, closed: AsyncEvent) -> AsyncMessages:
        return await self._channel.stream(call, request, closed)

    async def _stream(self, call: str, request: Any) -> AsyncIterator[Any]:
        messages = await self._open(call, request, self._closed)
        try:
            while (message := await messages.read()) is not None:
                yield message
        except grpc.RpcError as error:
            if not self._closed.is_set():
                raise from_rpc(self.address, error, call) from error
        finally:
            messages.cancel()

    def _register(self, stream: Snapshots) -> None:
        """Makes :meth:`close` end the stream, too."""
        with self._streams_lock:
            if self._closed.is_set():
                raise Closed("client")
            self._streams.add(stream)
