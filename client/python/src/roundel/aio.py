"""The same client for asyncio: calls are awaited, streams are `async for`.

What has been closed raises `Closed` when it is asked, and streams over it end.
"""

from __future__ import annotations

import asyncio
import copy
import time
import weakref
from types import TracebackType
from typing import Any, AsyncIterator, Mapping, Sequence

import grpc
import grpc.aio

from roundel import _calls, clock, v1
from roundel._address import target
from roundel._aio_snapshots import Latest, Snapshots, is_cancelled
from roundel.errors import Closed, RoundelError, ServerError, from_rpc
from roundel.history import History
from roundel.snapshot import Snapshot
from roundel.subscription import Subscription

__all__ = ["Client", "Latest", "Snapshots"]


class Client:
    """A connection to a server; it comes back by itself. To be made and used within one event loop."""

    def __init__(self, address: str = "http://127.0.0.1:7670", timeout_s: float | None = None) -> None:
        """Asks nothing of the server yet: it may come up later.

        A call that takes longer than `timeout_s` raises `TimedOut`; None: 15 s, and a minute where the server has to
        open, write or search something. Streams have no such end. See also :meth:`within`.
        """
        self.address = address
        self.timeout_s = _calls.timeout(timeout_s)
        self._channel = grpc.aio.insecure_channel(target(address), options=_calls.OPTIONS)
        self._closed = asyncio.Event()
        self._streams: weakref.WeakSet[Snapshots] = weakref.WeakSet()

    @classmethod
    async def connect(cls, address: str = "http://127.0.0.1:7670", timeout_s: float | None = None) -> Client:
        """The same, after making sure that a Roundel server is there."""
        client = cls(address, timeout_s)
        try:
            await client.info(timeout_s=_calls.CONNECT_TIMEOUT_S if timeout_s is None else timeout_s)
        except BaseException:
            # Cancelled too: nobody else knows of this connection.
            await client.close()
            raise
        return client

    def within(self, timeout_s: float) -> Client:
        """This client over the same connection, with another timeout: ``await client.within(0.2).drive(…)``."""
        other = copy.copy(self)
        other.timeout_s = _calls.timeout(timeout_s)
        return other

    async def close(self) -> None:
        """Ends the connection, and every stream over it, at once."""
        self._closed.set()
        for stream in list(self._streams):
            stream.close()
        await self._channel.close(None)

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def updates(self, subscription: Subscription | None = None) -> Snapshots:
        """Every snapshot from the newest on, and word of connections lost and back; reconnects by itself."""
        return Snapshots(self, subscription or Subscription())

    async def snapshots(self, subscription: Subscription | None = None) -> AsyncIterator[Snapshot]:
        """The same without the word, which is logged (logger ``roundel``)."""
        async with Snapshots(self, subscription or Subscription(), logs=True) as updates:
            async for update in updates:
                if isinstance(update, Snapshot):
                    yield update

    def latest(self, subscription: Subscription | None = None) -> Latest:
        """The newest snapshot at any time, for loops that run at a rate of their own."""
        return Latest(self, subscription or Subscription())

    async def snapshot(self, subscription: Subscription | None = None) -> Snapshot:
        """The newest snapshot, once."""
        request = (subscription or Subscription()).single_request()
        return Snapshot(await self._call("GetSnapshot", request))

    async def info(self, timeout_s: float | None = None) -> v1.ServerInfo:
        """What the server says of itself."""
        return await self._call("GetServerInfo", v1.GetServerInfoRequest(), timeout_s)  # type: ignore[no-any-return]

    async def objects(self) -> list[v1.Object]:
        """Every object of now and of the last minute, by id."""
        return list((await self._call("ListObjects", v1.ListObjectsRequest())).objects)

    async def cameras(self) -> list[v1.Camera]:
        """Every camera, in the order of the configuration."""
        return list((await self._call("ListCameras", v1.ListCamerasRequest())).cameras)

    def events(self, backlog: int = 0) -> AsyncIterator[v1.Event]:
        """Events from now on, after the newest `backlog` remembered ones; ends with an error when the connection is lost."""
        return self._stream("SubscribeEvents", v1.SubscribeEventsRequest(backlog=backlog))

    def observations(self, cameras: Sequence[str] = ()) -> AsyncIterator[v1.FrameObservations]:
        """What these cameras see, frame by frame; no names: all. Ends with an error when the connection is lost."""
        request = v1.SubscribeObservationsRequest(cameras=list(cameras))
        return self._stream("SubscribeObservations", request)

    async def newest_observations(self, cameras: Sequence[str] = ()) -> list[v1.FrameObservations]:
        """What these cameras saw in their newest frames, once; no names: all."""
        return list((await self._call("GetObservations", v1.GetObservationsRequest(cameras=list(cameras)))).frames)

    async def picture(self, camera: str) -> v1.CameraPicture:
        """What a camera sees, as a JPEG file with what was found drawn in; waits up to a second for a new frame."""
        return await self._call("GetPicture", v1.GetPictureRequest(camera=camera))  # type: ignore[no-any-return]

    async def clock_offset(self, probes: int = clock.PROBES) -> clock.ClockOffset:
        """By how much the server's clock is ahead of this machine's."""
        answers = []
        for _ in range(probes):
            answer = await self._call("GetTime", v1.GetTimeRequest(sent_time_ns=time.time_ns()))
            answers.append((answer, time.time_ns()))
        found = clock.best(answers)
        if found is None:
            raise ServerError("no probe of its clock made sense; a clock was set meanwhile", grpc.StatusCode.ABORTED)
        return found

    async def drive(self, velocities_m_s: Mapping[int, Sequence[float]]) -> int:
        """Tells simulated robots, by object_id, how to move for the next half second; from when on, server's ns."""
        request = _calls.drive_request(velocities_m_s)
        return int((await self._call("DriveRobots", request)).effective_time_ns)

    async def push(self, object_id: int, velocity_m_s: Sequence[float], duration_s: float) -> int:
        """Pushes a simulated robot, against what it is told; from when on, server's ns."""
        velocity = _calls.vector(velocity_m_s)
        request = v1.PushRobotRequest(object_id=object_id, velocity=velocity, duration_ms=duration_s * 1e3)
        return int((await self._call("PushRobot", request)).effective_time_ns)

    async def start_calibration(
        self, seconds: float | None = None, refine_lenses: bool = False, apply: str = "if_sound"
    ) -> v1.Calibration:
        """Begins to calibrate the arena; `apply` is one of if_sound, always, never."""
        request = _calls.calibration_request(seconds, refine_lenses, apply)
        return await self._call("StartCalibration", request)  # type: ignore[no-any-return]

    async def calibration(self) -> v1.Calibration:
        """The newest calibration."""
        return await self._call("GetCalibration", v1.GetCalibrationRequest())  # type: ignore[no-any-return]

    def watch_calibration(self) -> AsyncIterator[v1.Calibration]:
        """The newest calibration and each change of it."""
        return self._stream("WatchCalibration", v1.WatchCalibrationRequest())

    async def cancel_calibration(self) -> v1.Calibration:
        """Ends the one that is running, without a result."""
        return await self._call("CancelCalibration", v1.CancelCalibrationRequest())  # type: ignore[no-any-return]

    async def apply_calibration(self) -> v1.Calibration:
        """Has the cameras take over what the newest one found."""
        return await self._call("ApplyCalibration", v1.ApplyCalibrationRequest())  # type: ignore[no-any-return]

    async def test_source(self, source: str, width: int = 0, height: int = 0) -> v1.SourceTest:
        """Has the server open a source for about two seconds and say what it gives."""
        request = v1.TestSourceRequest(source=source, width=width, height=height)
        return await self._call("TestSource", request)  # type: ignore[no-any-return]

    async def camera_setup(self, name: str) -> v1.CameraSetup:
        """A camera as the server's configuration says it."""
        return await self._call("GetCameraSetup", v1.GetCameraSetupRequest(name=name))  # type: ignore[no-any-return]

    async def add_camera(self, camera: v1.CameraSetup) -> v1.CameraChange:
        """Adds a camera while the server runs."""
        return await self._call("AddCamera", v1.AddCameraRequest(camera=camera))  # type: ignore[no-any-return]

    async def change_camera(self, name: str, camera: v1.CameraSetup, fields: Sequence[str]) -> v1.CameraChange:
        """Changes these fields of a camera; one that is absent in `camera` is taken out."""
        request = v1.ChangeCameraRequest(name=name, camera=camera, fields=list(fields))
        return await self._call("ChangeCamera", request)  # type: ignore[no-any-return]

    async def remove_camera(self, name: str) -> v1.CameraChange:
        """Removes a camera while the server runs."""
        return await self._call("RemoveCamera", v1.RemoveCameraRequest(name=name))  # type: ignore[no-any-return]

    async def object_setup(self, name: str) -> v1.ObjectSetup:
        """An object as the server's configuration says it."""
        return await self._call("GetObjectSetup", v1.GetObjectSetupRequest(name=name))  # type: ignore[no-any-return]

    async def add_object(self, object: v1.ObjectSetup) -> v1.ObjectChange:
        """Adds an object while the server runs."""
        return await self._call("AddObject", v1.AddObjectRequest(object=object))  # type: ignore[no-any-return]

    async def change_object(self, name: str, object: v1.ObjectSetup, fields: Sequence[str]) -> v1.ObjectChange:
        """Changes these fields of an object; one that is absent in `object` is taken out."""
        request = v1.ChangeObjectRequest(name=name, object=object, fields=list(fields))
        return await self._call("ChangeObject", request)  # type: ignore[no-any-return]

    async def remove_object(self, name: str) -> v1.ObjectChange:
        """Removes an object while the server runs; one that was known by its code is followed on without a name."""
        return await self._call("RemoveObject", v1.RemoveObjectRequest(name=name))  # type: ignore[no-any-return]

    async def name_object(self, object_id: int, name: str) -> v1.ObjectChange:
        """Names an object that is seen, for good: by its code, or as the only one of its kind of roundel."""
        return await self._call("NameObject", v1.NameObjectRequest(object_id=object_id, name=name))  # type: ignore[no-any-return]

    async def configuration(self) -> v1.Configuration:
        """The configuration in force, as text and as message."""
        return await self._call("GetConfiguration", v1.GetConfigurationRequest())  # type: ignore[no-any-return]

    async def check_configuration(self, toml: str) -> v1.ConfigurationCheck:
        """What is wrong with a configuration, or what applying it would change; nothing is changed."""
        return await self._call("CheckConfiguration", v1.CheckConfigurationRequest(toml=toml))  # type: ignore[no-any-return]

    async def apply_configuration(self, toml: str, version: str = "") -> v1.AppliedConfiguration:
        """Puts a configuration in the place of the one in force, if that has this version still; empty: any."""
        request = v1.ApplyConfigurationRequest(toml=toml, version=version)
        return await self._call("ApplyConfiguration", request)  # type: ignore[no-any-return]

    # Recordings, and what was

    async def start_recording(
        self, name: str = "", frames_every: int | None = None, seconds: float | None = None
    ) -> v1.Recording:
        """Has the server record into files on its machine; one in `frames_every` frames as a picture, 0: none."""
        return await self._call("StartRecording", _calls.recording_request(name, frames_every, seconds))  # type: ignore[no-any-return]

    async def stop_recording(self) -> v1.Recording:
        """Ends the recording; its files are whole when this returns."""
        return await self._call("StopRecording", v1.StopRecordingRequest())  # type: ignore[no-any-return]

    async def recording(self) -> v1.Recording:
        """The recording that is being made, or the last one."""
        return await self._call("GetRecording", v1.GetRecordingRequest())  # type: ignore[no-any-return]

    async def recordings(self) -> list[v1.RecordingFile]:
        """The files of recordings in the server's folder, the oldest first."""
        return list((await self._call("ListRecordings", v1.ListRecordingsRequest())).files)

    async def replay(self) -> v1.Replay:
        """The recording that the server plays (``roundel replay``), and how far it is."""
        return await self._call("GetReplay", v1.GetReplayRequest())  # type: ignore[no-any-return]

    async def control_replay(
        self,
        paused: bool | None = None,
        speed: float | None = None,
        position_s: float | None = None,
        looping: bool | None = None,
    ) -> v1.Replay:
        """Pauses what the server plays, goes on, seeks, changes its speed; what is None stays as it is."""
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
        """Where objects (by id, name or code; none: all) were; from an hour before until now where times are 0."""
        request = _calls.history_request(objects, region_m, (from_ns, until_ns), max_points)
        return History(await self._call("QueryHistory", request))

    async def _call(self, call: str, request: Any, timeout_s: float | None = None) -> Any:
        if timeout_s is None:
            timeout_s = _calls.deadline_s(call, self.timeout_s)
        try:
            return await self._method(self._channel.unary_unary, call)(request, timeout=timeout_s)
        except grpc.aio.AioRpcError as error:
            raise self._failure(error, call, timeout_s) from error
        except grpc.aio.UsageError as error:
            raise self._misuse(error) from error
        except asyncio.CancelledError as error:
            if self._closed.is_set() and not is_cancelled():
                raise Closed("client") from error
            raise

    def _open(self, call: str, request: Any) -> Any:
        try:
            return self._method(self._channel.unary_stream, call)(request)
        except grpc.aio.UsageError as error:
            raise self._misuse(error) from error

    async def _stream(self, call: str, request: Any) -> AsyncIterator[Any]:
        messages = self._open(call, request)
        try:
            async for message in messages:
                yield message
        except grpc.aio.AioRpcError as error:
            if not self._closed.is_set():
                raise self._failure(error, call) from error
        except asyncio.CancelledError:
            if not self._closed.is_set() or is_cancelled():
                raise
        finally:
            messages.cancel()

    def _method(self, kind: Any, call: str) -> Any:
        if self._closed.is_set():
            raise Closed("client")
        return kind(_calls.path(call), _calls.encoded, _calls.ANSWERS[call].FromString)

    def _failure(self, error: grpc.RpcError, call: str, timeout_s: float | None = None) -> RoundelError:
        return Closed("client") if self._closed.is_set() else from_rpc(self.address, error, call, timeout_s)

    def _misuse(self, error: grpc.aio.UsageError) -> Exception:
        return Closed("client") if self._closed.is_set() else error

    def _adopt(self, stream: Snapshots) -> None:
        """Has a stream closed with this client."""
        if self._closed.is_set():
            raise Closed("client")
        self._streams.add(stream)
