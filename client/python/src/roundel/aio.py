"""The same client for asyncio: calls are awaited, streams are `async for`."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from types import TracebackType
from typing import Any, AsyncIterator, Mapping, Sequence

import grpc
import grpc.aio

from roundel import _calls, clock, v1
from roundel._address import target
from roundel._follower import Follower
from roundel.errors import RoundelError, ServerError, Unreachable, from_rpc
from roundel.snapshot import Snapshot, Update
from roundel.subscription import Subscription


class Client:
    """A connection to a server; it comes back by itself. To be made and used within one event loop."""

    def __init__(self, address: str = "http://127.0.0.1:7670") -> None:
        """Asks nothing of the server yet: it may come up later."""
        self.address = address
        self._channel = grpc.aio.insecure_channel(target(address), options=_calls.OPTIONS)

    @classmethod
    async def connect(cls, address: str = "http://127.0.0.1:7670") -> Client:
        """The same, after making sure that a Roundel server is there."""
        client = cls(address)
        try:
            await client.info(timeout_s=_calls.CONNECT_TIMEOUT_S)
        except RoundelError:
            await client.close()
            raise
        return client

    async def close(self) -> None:
        """Ends the connection, and every stream over it."""
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
        updates = self.updates(subscription)
        try:
            async for update in updates:
                if isinstance(update, Snapshot):
                    yield update
        finally:
            updates.close()

    def latest(self, subscription: Subscription | None = None) -> Latest:
        """The newest snapshot at any time, for loops that run at a rate of their own."""
        return Latest(self, subscription or Subscription())

    async def snapshot(self) -> Snapshot:
        """The newest snapshot, once."""
        return Snapshot(await self._call("GetSnapshot", v1.GetSnapshotRequest()))

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

    async def _call(self, call: str, request: Any, timeout_s: float | None = None) -> Any:
        method = self._channel.unary_unary(_calls.path(call), _calls.encoded, _calls.ANSWERS[call].FromString)
        try:
            return await method(request, timeout=timeout_s)
        except grpc.aio.AioRpcError as error:
            raise from_rpc(self.address, error) from error

    def _open(self, call: str, request: Any) -> Any:
        method = self._channel.unary_stream(_calls.path(call), _calls.encoded, _calls.ANSWERS[call].FromString)
        return method(request)

    async def _stream(self, call: str, request: Any) -> AsyncIterator[Any]:
        messages = self._open(call, request)
        try:
            async for message in messages:
                yield message
        except grpc.aio.AioRpcError as error:
            raise from_rpc(self.address, error) from error
        finally:
            messages.cancel()


class Snapshots(AsyncIterator[Update]):
    """Snapshots, and word of connections lost and back; ends when closed, or with an error that asking again cannot heal."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._client = client
        self._request = subscription.request()
        self._follower = Follower()
        self._held: deque[Update] = deque()
        self._messages: Any = None
        self._pause_s = 0.0
        self._is_closed = False

    @property
    def missed(self) -> int:
        """Snapshots missed so far, since this client was too slow for them or had no connection."""
        return self._follower.missed

    def close(self) -> None:
        """Ends the stream."""
        self._is_closed = True
        if self._messages is not None:
            self._messages.cancel()

    def __aiter__(self) -> Snapshots:
        return self

    async def __anext__(self) -> Update:
        if not self._held:
            if self._pause_s:
                await asyncio.sleep(self._pause_s)
                self._pause_s = 0.0
            await self._receive()
        return self._held.popleft()

    async def _receive(self) -> None:
        if self._is_closed:
            raise StopAsyncIteration
        try:
            if self._messages is None:
                self._messages = self._client._open("SubscribeSnapshots", self._request)
            message = await self._messages.read()
        except grpc.aio.AioRpcError as failure:
            self._lost(from_rpc(self._client.address, failure))
        except asyncio.CancelledError:
            # Closed by another task, and not a cancellation of this one.
            if self._is_closed:
                raise StopAsyncIteration from None
            raise
        else:
            if message is grpc.aio.EOF:  # type: ignore[attr-defined]
                self._lost(Unreachable(self._client.address, "the server ended the stream"))
            else:
                self._held.extend(self._follower.received(message))

    def _lost(self, error: RoundelError) -> None:
        self._messages = None
        update = self._follower.lost(error)
        self._pause_s = update.retry_in_s
        self._held.append(update)


class Latest:
    """The newest snapshot at any time. A task reads; whoever asks gets the newest, and nothing waits for it."""

    def __init__(self, client: Client, subscription: Subscription) -> None:
        self._updates = Snapshots(client, subscription)
        self._value: Snapshot | None = None
        self._fresh = asyncio.Event()
        self.skipped = 0
        """Snapshots that came and were replaced before anybody took them."""
        self._reader = asyncio.create_task(self._read(), name="roundel-latest")

    @property
    def value(self) -> Snapshot | None:
        """The newest snapshot; None before the first. Does not wait."""
        self._fresh.clear()
        return self._value

    @property
    def missed(self) -> int:
        """Snapshots that never came, as of :attr:`Snapshots.missed`."""
        return self._updates.missed

    async def next(self) -> Snapshot:
        """The newest snapshot that nobody has taken yet; waits for one."""
        fresh = asyncio.create_task(self._fresh.wait())
        try:
            await asyncio.wait({fresh, self._reader}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            fresh.cancel()
        if self._fresh.is_set() and self._value is not None:
            self._fresh.clear()
            return self._value
        # The reader has ended: with an error, or since it was closed.
        await self._reader
        raise StopAsyncIteration

    def __aiter__(self) -> Latest:
        return self

    async def __anext__(self) -> Snapshot:
        return await self.next()

    async def close(self) -> None:
        """Ends the stream and its task."""
        self._updates.close()
        self._reader.cancel()
        await asyncio.gather(self._reader, return_exceptions=True)

    async def __aenter__(self) -> Latest:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _read(self) -> None:
        async for update in self._updates:
            if isinstance(update, Snapshot):
                self.skipped += self._fresh.is_set()
                self._value = update
                self._fresh.set()
