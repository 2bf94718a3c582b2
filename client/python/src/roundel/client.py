"""The plain client: calls that return, and iterators that wait.

A client may be used from several threads; an iterator belongs to one of them, but for `close`.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from types import TracebackType
from typing import Any, Iterator, Mapping, Sequence

import grpc

from roundel import _calls, clock, v1
from roundel._address import target
from roundel._follower import Follower, Newest, log
from roundel.errors import RoundelError, ServerError, Unreachable, from_rpc
from roundel.snapshot import Snapshot, Update
from roundel.subscription import Subscription


class Client:
    """A connection to a server; it comes back by itself."""

    def __init__(self, address: str = "http://127.0.0.1:7670") -> None:
        """Asks nothing of the server yet: it may come up later."""
        self.address = address
        self._channel = grpc.insecure_channel(target(address), options=_calls.OPTIONS)

    @classmethod
    def connect(cls, address: str = "http://127.0.0.1:7670") -> Client:
        """The same, after making sure that a Roundel server is there."""
        client = cls(address)
        try:
            client.info(timeout_s=_calls.CONNECT_TIMEOUT_S)
        except RoundelError:
            client.close()
            raise
        return client

    def close(self) -> None:
        """Ends the connection, and every iterator over it."""
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
        with self.updates(subscription) as updates:
            for update in updates:
                if isinstance(update, Snapshot):
                    yield update

    def latest(self, subscription: Subscription | None = None) -> Latest:
        """The newest snapshot at any time, for loops that run at a rate of their own."""
        return Latest(self, subscription or Subscription())

    def snapshot(self) -> Snapshot:
        """The newest snapshot, once."""
        return Snapshot(self._call("GetSnapshot", v1.GetSnapshotRequest()))

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

    def _call(self, call: str, request: Any, timeout_s: float | None = None) -> Any:
        method = self._channel.unary_unary(_calls.path(call), _calls.encoded, _calls.ANSWERS[call].FromString)
        try:
            return method(request, timeout=timeout_s)
        except grpc.RpcError as error:
            raise from_rpc(self.address, error) from error

    def _open(self, call: str, request: Any) -> Any:
        method = self._channel.unary_stream(_calls.path(call), _calls.encoded, _calls.ANSWERS[call].FromString)
        return method(request)

    def _stream(self, call: str, request: Any) -> Iterator[Any]:
        messages = self._open(call, request)
        try:
            yield from messages
        except grpc.RpcError as error:
            raise from_rpc(self.address, error) from error
        finally:
            messages.cancel()


class Snapshots(Iterator[Update]):
    """Snapshots, and word of connections lost and back; ends when closed, or with an error that asking again cannot heal."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._client = client
        self._request = subscription.request()
        self._follower = Follower()
        self._held: deque[Update] = deque()
        self._messages: Any = None
        self._pause_s = 0.0
        self._closed = threading.Event()

    @property
    def missed(self) -> int:
        """Snapshots missed so far, since this client was too slow for them or had no connection."""
        return self._follower.missed

    def close(self) -> None:
        """Ends the stream; another thread that waits for its next value is let go."""
        self._closed.set()
        if self._messages is not None:
            self._messages.cancel()

    def __enter__(self) -> Snapshots:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Snapshots:
        return self

    def __next__(self) -> Update:
        if not self._held:
            if self._pause_s and self._closed.wait(self._pause_s):
                raise StopIteration
            self._pause_s = 0.0
            self._receive()
        return self._held.popleft()

    def _receive(self) -> None:
        try:
            if self._messages is None:
                self._messages = self._client._open("SubscribeSnapshots", self._request)
            if self._closed.is_set():
                self._messages.cancel()
                raise StopIteration
            message = next(self._messages, None)
        except grpc.RpcError as failure:
            if self._closed.is_set():
                raise StopIteration from None
            self._lost(from_rpc(self._client.address, failure))
        except ValueError as failure:
            # grpc's word for a channel that was closed.
            raise StopIteration from failure
        else:
            if message is None:
                self._lost(Unreachable(self._client.address, "the server ended the stream"))
            else:
                self._held.extend(self._follower.received(message))

    def _lost(self, error: RoundelError) -> None:
        self._messages = None
        update = self._follower.lost(error)
        self._pause_s = update.retry_in_s
        self._held.append(update)


class Latest:
    """The newest snapshot at any time. A thread reads; whoever asks gets the newest, and nothing waits for it."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._updates = Snapshots(client, subscription)
        self._newest = Newest()
        self._reader = threading.Thread(target=self._read, name="roundel-latest", daemon=True)
        self._reader.start()

    @property
    def value(self) -> Snapshot | None:
        """The newest snapshot; None before the first. Does not wait."""
        with self._newest.changed:
            self._newest.is_taken = True
            return self._newest.value

    @property
    def skipped(self) -> int:
        """Snapshots that came and were replaced before anybody took them."""
        return self._newest.skipped

    @property
    def missed(self) -> int:
        """Snapshots that never came, as of :attr:`Snapshots.missed`."""
        return self._updates.missed

    def next(self, timeout_s: float | None = None) -> Snapshot:
        """The newest snapshot that nobody has taken yet; waits for one, and raises TimeoutError in vain."""
        newest = self._newest
        with newest.changed:
            if not newest.changed.wait_for(lambda: newest.is_closed or not newest.is_taken, timeout_s):
                raise TimeoutError(f"no snapshot within {timeout_s} s")
            if newest.value is not None and not newest.is_taken:
                newest.is_taken = True
                return newest.value
            if newest.failure is not None:
                raise newest.failure
            raise StopIteration

    def __iter__(self) -> Iterator[Snapshot]:
        while True:
            try:
                snapshot = self.next()
            except StopIteration:
                return
            yield snapshot

    def close(self) -> None:
        """Ends the stream and its thread."""
        self._updates.close()
        self._reader.join()

    def __enter__(self) -> Latest:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _read(self) -> None:
        failure: BaseException | None = None
        try:
            for update in self._updates:
                if isinstance(update, Snapshot):
                    self._newest.put(update)
        except RoundelError as error:
            log.error("%s", error)
            failure = error
        self._newest.end(failure)
