"""The plain client: calls that return, and iterators that wait.

A client may be used from several threads; an iterator belongs to one of them, but for `close`. Every call can raise
what `errors` lists; what has been closed raises `Closed` when it is asked, and iterators over it end.
"""

from __future__ import annotations

import copy
import threading
import time
import weakref
from types import TracebackType
from typing import Any, Iterator, Mapping, Sequence

import grpc

from roundel import _calls, clock, v1
from roundel._address import target
from roundel._snapshots import Latest, Snapshots
from roundel.errors import Closed, RoundelError, ServerError, from_rpc
from roundel.history import History
from roundel.snapshot import Snapshot
from roundel.subscription import Subscription

__all__ = ["Client", "Latest", "Snapshots"]


class Client:
    """A connection to a server; it comes back by itself."""

    def __init__(self, address: str = "http://127.0.0.1:7670", timeout_s: float | None = None) -> None:
        """Asks nothing of the server yet: it may come up later.

        A call that takes longer than `timeout_s` raises `TimedOut`; None: 15 s, and a minute where the server has to
        open, write or search something. Streams have no such end. See also :meth:`within`.
        """
        self.address = address
        self.timeout_s = _calls.timeout(timeout_s)
        self._channel = grpc.insecure_channel(target(address), options=_calls.OPTIONS)
        self._closed = threading.Event()
        self._streams: weakref.WeakSet[Snapshots] = weakref.WeakSet()
        self._adopting = threading.Lock()

    @classmethod
    def connect(cls, address: str = "http://127.0.0.1:7670", timeout_s: float | None = None) -> Client:
        """The same, after making sure that a Roundel server is there."""
        client = cls(address, timeout_s)
        try:
            client.info(timeout_s=_calls.CONNECT_TIMEOUT_S if timeout_s is None else timeout_s)
        except RoundelError:
            client.close()
            raise
        return client

    def within(self, timeout_s: float) -> Client:
        """This client over the same connection, with another timeout: ``client.within(0.2).drive(…)``."""
        other = copy.copy(self)
        other.timeout_s = _calls.timeout(timeout_s)
        return other

    def close(self) -> None:
        """Ends the connection, and every iterator over it, at once."""
        with self._adopting:
            self._closed.set()
            streams = list(self._streams)
        for stream in streams:
            stream.close()
        self._channel.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # Snapshots

    def updates(self, subscription: Subscription | None = None) -> Snapshots:
        """Every snapshot from the newest on, and word of connections lost and back; reconnects by itself."""
        return Snapshots(self, subscription or Subscription())

    def snapshots(self, subscription: Subscription | None = None) -> Iterator[Snapshot]:
        """The same without the word, which is logged (logger ``roundel``)."""
        with Snapshots(self, subscription or Subscription(), logs=True) as updates:
            for update in updates:
                if isinstance(update, Snapshot):
                    yield update

    def latest(self, subscription: Subscription | None = None) -> Latest:
        """The newest snapshot at any time, for loops that run at a rate of their own."""
        return Latest(self, subscription or Subscription())

    def snapshot(self, subscription: Subscription | None = None) -> Snapshot:
        """The newest snapshot, once."""
        request = (subscription or Subscription()).single_request()
        return Snapshot(self._call("GetSnapshot", request))

    # What else there is

    def info(self, timeout_s: float | None = None) -> v1.ServerInfo:
        """What the server says of itself."""
        return self._call("GetServerInfo", v1.GetServerInfoRequest(), timeout_s)  # type: ignore[no-any-return]

    def objects(self) -> list[v1.Object]:
        """Every object of now and of the last minute, by id."""
        return list(self._call("ListObjects", v1.ListObjectsRequest()).objects)

    def cameras(self) -> list[v1.Camera]:
        """Every camera, in the order of the configuration."""
        return list(self._call("ListCameras", v1.ListCamerasRequest()).cameras)

    def events(self, backlog: int = 0) -> Iterator[v1.Event]:
        """Events from now on, after the newest `backlog` remembered ones; ends with an error when the connection is lost."""
        return self._stream("SubscribeEvents", v1.SubscribeEventsRequest(backlog=backlog))

    def observations(self, cameras: Sequence[str] = ()) -> Iterator[v1.FrameObservations]:
        """What these cameras see, frame by frame; no names: all. Ends with an error when the connection is lost."""
        request = v1.SubscribeObservationsRequest(cameras=list(cameras))
        return self._stream("SubscribeObservations", request)

    def newest_observations(self, cameras: Sequence[str] = ()) -> list[v1.FrameObservations]:
        """What these cameras saw in their newest frames, once; no names: all."""
        return list(self._call("GetObservations", v1.GetObservationsRequest(cameras=list(cameras))).frames)

    def picture(self, camera: str) -> v1.CameraPicture:
        """What a camera sees, as a JPEG file with what was found drawn in; waits up to a second for a new frame."""
        return self._call("GetPicture", v1.GetPictureRequest(camera=camera))  # type: ignore[no-any-return]

    def clock_offset(self, probes: int = clock.PROBES) -> clock.ClockOffset:
        """By how much the server's clock is ahead of this machine's."""
        answers = []
        for _ in range(probes):
            answer = self._call("GetTime", v1.GetTimeRequest(sent_time_ns=time.time_ns()))
            answers.append((answer, time.time_ns()))
        found = clock.best(answers)
        if found is None:
            raise ServerError("no probe of its clock made sense; a clock was set meanwhile", grpc.StatusCode.ABORTED)
        return found

    # Simulated robots

    def drive(self, velocities_m_s: Mapping[int, Sequence[float]]) -> int:
        """Tells simulated robots, by object_id, how to move for the next half second; from when on, server's ns."""
        return int(self._call("DriveRobots", _calls.drive_request(velocities_m_s)).effective_time_ns)

    def push(self, object_id: int, velocity_m_s: Sequence[float], duration_s: float) -> int:
        """Pushes a simulated robot, against what it is told; from when on, server's ns."""
        velocity = _calls.vector(velocity_m_s)
        request = v1.PushRobotRequest(object_id=object_id, velocity=velocity, duration_ms=duration_s * 1e3)
        return int(self._call("PushRobot", request).effective_time_ns)

    # Setting up

    def start_calibration(
        self, seconds: float | None = None, refine_lenses: bool = False, apply: str = "if_sound"
    ) -> v1.Calibration:
        """Begins to calibrate the arena; `apply` is one of if_sound, always, never."""
        request = _calls.calibration_request(seconds, refine_lenses, apply)
        return self._call("StartCalibration", request)  # type: ignore[no-any-return]

    def calibration(self) -> v1.Calibration:
        """The newest calibration."""
        return self._call("GetCalibration", v1.GetCalibrationRequest())  # type: ignore[no-any-return]

    def watch_calibration(self) -> Iterator[v1.Calibration]:
        """The newest calibration and each change of it."""
        return self._stream("WatchCalibration", v1.WatchCalibrationRequest())

    def cancel_calibration(self) -> v1.Calibration:
        """Ends the one that is running, without a result."""
        return self._call("CancelCalibration", v1.CancelCalibrationRequest())  # type: ignore[no-any-return]

    def apply_calibration(self) -> v1.Calibration:
        """Has the cameras take over what the newest one found."""
        return self._call("ApplyCalibration", v1.ApplyCalibrationRequest())  # type: ignore[no-any-return]

    def test_source(self, source: str, width: int = 0, height: int = 0) -> v1.SourceTest:
        """Has the server open a source for about two seconds and say what it gives."""
        request = v1.TestSourceRequest(source=source, width=width, height=height)
        return self._call("TestSource", request)  # type: ignore[no-any-return]

    def camera_setup(self, name: str) -> v1.CameraSetup:
        """A camera as the server's configuration says it."""
        return self._call("GetCameraSetup", v1.GetCameraSetupRequest(name=name))  # type: ignore[no-any-return]

    def add_camera(self, camera: v1.CameraSetup) -> v1.CameraChange:
        """Adds a camera while the server runs."""
        return self._call("AddCamera", v1.AddCameraRequest(camera=camera))  # type: ignore[no-any-return]

    def change_camera(self, name: str, camera: v1.CameraSetup, fields: Sequence[str]) -> v1.CameraChange:
        """Changes these fields of a camera; one that is absent in `camera` is taken out."""
        request = v1.ChangeCameraRequest(name=name, camera=camera, fields=list(fields))
        return self._call("ChangeCamera", request)  # type: ignore[no-any-return]

    def remove_camera(self, name: str) -> v1.CameraChange:
        """Removes a camera while the server runs."""
        return self._call("RemoveCamera", v1.RemoveCameraRequest(name=name))  # type: ignore[no-any-return]

    def object_setup(self, name: str) -> v1.ObjectSetup:
        """An object as the server's configuration says it."""
        return self._call("GetObjectSetup", v1.GetObjectSetupRequest(name=name))  # type: ignore[no-any-return]

    def add_object(self, object: v1.ObjectSetup) -> v1.ObjectChange:
        """Adds an object while the server runs."""
        return self._call("AddObject", v1.AddObjectRequest(object=object))  # type: ignore[no-any-return]

    def change_object(self, name: str, object: v1.ObjectSetup, fields: Sequence[str]) -> v1.ObjectChange:
        """Changes these fields of an object; one that is absent in `object` is taken out."""
        request = v1.ChangeObjectRequest(name=name, object=object, fields=list(fields))
        return self._call("ChangeObject", request)  # type: ignore[no-any-return]

    def remove_object(self, name: str) -> v1.ObjectChange:
        """Removes an object while the server runs; one that was known by its code is followed on without a name."""
        return self._call("RemoveObject", v1.RemoveObjectRequest(name=name))  # type: ignore[no-any-return]

    def name_object(self, object_id: int, name: str) -> v1.ObjectChange:
        """Names an object that is seen, for good: by its code, or as the only one of its kind of roundel."""
        return self._call("NameObject", v1.NameObjectRequest(object_id=object_id, name=name))  # type: ignore[no-any-return]

    def configuration(self) -> v1.Configuration:
        """The configuration in force, as text and as message."""
        return self._call("GetConfiguration", v1.GetConfigurationRequest())  # type: ignore[no-any-return]

    def check_configuration(self, toml: str) -> v1.ConfigurationCheck:
        """What is wrong with a configuration, or what applying it would change; nothing is changed."""
        return self._call("CheckConfiguration", v1.CheckConfigurationRequest(toml=toml))  # type: ignore[no-any-return]

    def apply_configuration(self, toml: str, version: str = "") -> v1.AppliedConfiguration:
        """Puts a configuration in the place of the one in force, if that has this version still; empty: any."""
        request = v1.ApplyConfigurationRequest(toml=toml, version=version)
        return self._call("ApplyConfiguration", request)  # type: ignore[no-any-return]

    # Recordings, and what was

    def start_recording(
        self, name: str = "", frames_every: int | None = None, seconds: float | None = None
    ) -> v1.Recording:
        """Has the server record into files on its machine; one in `frames_every` frames as a picture, 0: none."""
        return self._call("StartRecording", _calls.recording_request(name, frames_every, seconds))  # type: ignore[no-any-return]

    def stop_recording(self) -> v1.Recording:
        """Ends the recording; its files are whole when this returns."""
        return self._call("StopRecording", v1.StopRecordingRequest())  # type: ignore[no-any-return]

    def recording(self) -> v1.Recording:
        """The recording that is being made, or the last one."""
        return self._call("GetRecording", v1.GetRecordingRequest())  # type: ignore[no-any-return]

    def recordings(self) -> list[v1.RecordingFile]:
        """The files of recordings in the server's folder, the oldest first."""
        return list(self._call("ListRecordings", v1.ListRecordingsRequest()).files)

    def replay(self) -> v1.Replay:
        """The recording that the server plays (``roundel replay``), and how far it is."""
        return self._call("GetReplay", v1.GetReplayRequest())  # type: ignore[no-any-return]

    def control_replay(
        self,
        paused: bool | None = None,
        speed: float | None = None,
        position_s: float | None = None,
        looping: bool | None = None,
    ) -> v1.Replay:
        """Pauses what the server plays, goes on, seeks, changes its speed; what is None stays as it is."""
        request = _calls.replay_request(paused, speed, position_s, looping)
        return self._call("ControlReplay", request)  # type: ignore[no-any-return]

    def history(
        self,
        objects: Sequence[int | str] = (),
        region_m: tuple[Sequence[float], Sequence[float]] | None = None,
        from_ns: int = 0,
        until_ns: int = 0,
        max_points: int = 0,
    ) -> History:
        """Where objects (by id, name or code; none: all) were; from an hour before until now where times are 0."""
        request = _calls.history_request(objects, region_m, (from_ns, until_ns), max_points)
        return History(self._call("QueryHistory", request))

    def _call(self, call: str, request: Any, timeout_s: float | None = None) -> Any:
        if timeout_s is None:
            timeout_s = _calls.deadline_s(call, self.timeout_s)
        try:
            method = self._channel.unary_unary(_calls.path(call), _calls.encoded, _calls.ANSWERS[call].FromString)
            return method(request, timeout=timeout_s)
        except grpc.RpcError as error:
            raise self._failure(error, call, timeout_s) from error
        except ValueError as error:
            raise self._misuse(error) from error

    def _open(self, call: str, request: Any) -> Any:
        try:
            method = self._channel.unary_stream(_calls.path(call), _calls.encoded, _calls.ANSWERS[call].FromString)
            return method(request)
        except ValueError as error:
            raise self._misuse(error) from error

    def _stream(self, call: str, request: Any) -> Iterator[Any]:
        messages = self._open(call, request)
        try:
            yield from messages
        except grpc.RpcError as error:
            if not self._closed.is_set():
                raise self._failure(error, call) from error
        finally:
            messages.cancel()

    def _failure(self, error: grpc.RpcError, call: str, timeout_s: float | None = None) -> RoundelError:
        return Closed("client") if self._closed.is_set() else from_rpc(self.address, error, call, timeout_s)

    def _misuse(self, error: ValueError) -> Exception:
        """A ValueError is grpc's word for a channel that was closed, and for what cannot be encoded."""
        return Closed("client") if self._closed.is_set() else error

    def _adopt(self, stream: Snapshots) -> None:
        """Has a stream closed with this client."""
        with self._adopting:
            if self._closed.is_set():
                raise Closed("client")
            self._streams.add(stream)
