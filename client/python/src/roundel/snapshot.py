"""All objects at one instant, as NumPy arrays.

Row i of each array is the same object. Conventions are those of the .proto files: world frame, metres, radians, seconds;
quaternions x y z w; times in ns since the Unix epoch.
"""

from __future__ import annotations

import enum
import functools
import math
from dataclasses import dataclass, field
from typing import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from roundel import _rotation, v1
from roundel._rotation import Floats

ACCELERATION_TIME_CONSTANT_S = 0.4
"""Predicted accelerations decay by exp(-t / 0.4 s)."""

_TRIANGLE_6 = np.triu_indices(6)
_TRIANGLE_3 = np.triu_indices(3)


class LifeStage(enum.IntEnum):
    """Stage in the life of a track."""

    UNSPECIFIED = 0
    TENTATIVE = 1
    """Not confirmed by enough observations yet."""
    TRACKED = 2
    """Currently observed."""
    PREDICTED = 3
    """Currently not observed; the pose comes from the motion model."""
    LOST = 4
    """No longer tracked."""


@dataclass(frozen=True)
class Robot:
    """One object of a snapshot."""

    object_id: int
    name: str
    roundel: str
    """Configured name of its kind of roundel."""
    code: int | None
    """Number of its code; None without a code, or before it was read."""
    stage: LifeStage
    position_m: Floats
    velocity_m_s: Floats
    orientation: Floats
    """world_from_object, quaternion x y z w."""
    yaw_observed: bool
    age_ns: int
    """Pose time minus the capture time of the newest observation used."""
    covariance: Floats | None
    """6x6 over (position m, rotation rad); None if omitted."""

    @property
    def yaw_rad(self) -> float | None:
        """Angle of its x axis about the world's z axis, counterclockwise from the world's x axis; None if not observed."""
        if not self.yaw_observed:
            return None
        x, y, z, w = self.orientation
        return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))

    @property
    def speed_m_s(self) -> float:
        """Norm of the velocity."""
        return float(np.linalg.norm(self.velocity_m_s))

    @property
    def position_sigma_m(self) -> Floats | None:
        """Standard deviations of the position along the world's axes."""
        if self.covariance is None:
            return None
        sigmas: Floats = np.sqrt(np.clip(np.diagonal(self.covariance)[:3], 0.0, None))
        return sigmas


@dataclass(frozen=True)
class _Kinematics:
    """The arrays that a prediction changes."""

    positions_m: Floats
    velocities_m_s: Floats
    accelerations_m_s2: Floats
    orientations: Floats


@dataclass(frozen=True)
class Snapshot:
    """All objects of a subscription at `pose_time_ns`. Arrays are built on first use."""

    message: v1.Snapshot
    ahead_s: float = 0.0
    """How far this client has predicted it past the server's pose time."""
    _predicted: _Kinematics | None = field(default=None, repr=False, compare=False)

    @property
    def sequence(self) -> int:
        """Increases by one with each snapshot of this server."""
        return self.message.sequence

    @property
    def source_id(self) -> str:
        """Identifies the server and its run; changes with each restart."""
        return self.message.source_id

    @property
    def missed(self) -> int:
        """Subscribed snapshots skipped since the previous one, because this client read too slowly."""
        return self.message.missed

    @property
    def pose_time_ns(self) -> int:
        """The instant of all poses."""
        return self.message.pose_time_ns + round(self.ahead_s * 1e9)

    @property
    def capture_time_ns(self) -> int:
        """Capture time of the newest observation used; 0 before the first."""
        return self.message.capture_time_ns

    def __len__(self) -> int:
        return len(self.message.objects)

    @functools.cached_property
    def ids(self) -> NDArray[np.uint64]:
        """object_id, shape (n,), ascending."""
        return np.array([o.object_id for o in self.message.objects], dtype=np.uint64)

    @functools.cached_property
    def names(self) -> list[str]:
        """Configured names; empty for objects without one."""
        return [o.name for o in self.message.objects]

    @functools.cached_property
    def codes(self) -> list[int | None]:
        """Numbers of the codes; None without a code, or before it was read."""
        return [o.code.number if o.HasField("code") else None for o in self.message.objects]

    @property
    def tracked(self) -> NDArray[np.bool_]:
        """Which objects are currently observed, shape (n,). The poses of the others are predicted."""
        mask: NDArray[np.bool_] = self.stages == LifeStage.TRACKED
        return mask

    @functools.cached_property
    def stages(self) -> NDArray[np.int64]:
        """Values of :class:`LifeStage`, shape (n,)."""
        return np.array([o.stage for o in self.message.objects], dtype=np.int64)

    @functools.cached_property
    def yaw_observed(self) -> NDArray[np.bool_]:
        """False where the rotation about the roundel's normal is only a convention; shape (n,)."""
        return np.array([o.yaw_observed for o in self.message.objects], dtype=np.bool_)

    @functools.cached_property
    def untrusted(self) -> NDArray[np.bool_]:
        """Which objects only cameras with `trust = 0` see, by default those of remote programs; shape (n,)."""
        return np.array([o.untrusted for o in self.message.objects], dtype=np.bool_)

    @functools.cached_property
    def _kinematics(self) -> _Kinematics:
        if self._predicted is not None:
            return self._predicted
        objects = self.message.objects
        return _Kinematics(
            positions_m=_vectors(objects, lambda o: o.position),
            velocities_m_s=_vectors(objects, lambda o: o.velocity),
            accelerations_m_s2=_vectors(objects, lambda o: o.acceleration),
            orientations=np.array(
                [(q.x, q.y, q.z, q.w) for q in (o.orientation for o in objects)], dtype=np.float64
            ).reshape(-1, 4),
        )

    @property
    def positions_m(self) -> Floats:
        """Positions of the tracked points, shape (n, 3)."""
        return self._kinematics.positions_m

    @property
    def velocities_m_s(self) -> Floats:
        """Shape (n, 3)."""
        return self._kinematics.velocities_m_s

    @property
    def accelerations_m_s2(self) -> Floats:
        """Shape (n, 3); 0 with covariances omitted, or from servers that do not send accelerations."""
        return self._kinematics.accelerations_m_s2

    @property
    def orientations(self) -> Floats:
        """world_from_object, quaternions x y z w, shape (n, 4)."""
        return self._kinematics.orientations

    @functools.cached_property
    def angular_velocities_rad_s(self) -> Floats:
        """World frame, shape (n, 3)."""
        return _vectors(self.message.objects, lambda o: o.angular_velocity)

    @functools.cached_property
    def rotations(self) -> Floats:
        """world_from_object as matrices, shape (n, 3, 3)."""
        return _rotation.matrices(self.orientations)

    @functools.cached_property
    def covariances(self) -> Floats | None:
        """Covariances over (position m, rotation rad), shape (n, 6, 6).

        None if omitted, and in snapshots predicted by this client. Only the server can predict covariances: subscribe
        with `horizon_s`.
        """
        if self.ahead_s != 0.0:
            return None
        return _symmetric([o.covariance for o in self.message.objects], 6, _TRIANGLE_6)

    @functools.cached_property
    def velocity_covariances(self) -> Floats | None:
        """(m/s)^2, shape (n, 3, 3); None as for :attr:`covariances`."""
        if self.ahead_s != 0.0:
            return None
        return _symmetric([o.velocity_covariance for o in self.message.objects], 3, _TRIANGLE_3)

    def index(self, object_id: int) -> int | None:
        """The row of an object; None if it is not in this snapshot."""
        rows = np.flatnonzero(self.ids == object_id)
        return int(rows[0]) if len(rows) else None

    def robot(self, which: int | str) -> Robot | None:
        """One object, by object_id or name; None if it is not in this snapshot."""
        row = _index_of(self.names, which) if isinstance(which, str) else self.index(which)
        return None if row is None else self[row]

    def coded(self, number: int) -> Robot | None:
        """The object with this code; None if it is not in this snapshot."""
        row = _index_of(self.codes, number)
        return None if row is None else self[row]

    def position_m(self, which: int | str) -> Floats | None:
        """Position of one object, by object_id or name, shape (3,); None if it is not in this snapshot."""
        robot = self.robot(which)
        return None if robot is None else robot.position_m

    def __getitem__(self, row: int) -> Robot:
        state = self.message.objects[row]
        return Robot(
            object_id=state.object_id,
            name=state.name,
            roundel=state.roundel,
            code=self.codes[row],
            stage=_stage(state.stage),
            position_m=self.positions_m[row],
            velocity_m_s=self.velocities_m_s[row],
            orientation=self.orientations[row],
            yaw_observed=state.yaw_observed,
            age_ns=state.observation_age_ns + round(self.ahead_s * 1e9),
            covariance=None if self.covariances is None else self.covariances[row],
        )

    def predicted(self, seconds: float) -> Snapshot:
        """The snapshot predicted by `seconds`, with the server's motion model.

        Accelerations decay by e = exp(-t / L), L = 0.4 s. Velocities change by a L (1 - e), positions by
        v t + a L (t - L (1 - e)). Angular velocities are constant.

        A subscription with ``covariance=False`` receives no accelerations, so its snapshots are predicted by velocities
        only. With `horizon_s` the server predicts instead, with accelerations.
        """
        if not np.isfinite(seconds):
            raise ValueError(f"expected a finite number of seconds, found {seconds}")
        time_constant_s, now = ACCELERATION_TIME_CONSTANT_S, self._kinematics
        decay = float(np.exp(-seconds / time_constant_s))
        integral_s = time_constant_s * (1.0 - decay)
        acceleration = now.accelerations_m_s2
        rotation = _rotation.from_rotation_vector(self.angular_velocities_rad_s * seconds)
        predicted = _Kinematics(
            positions_m=now.positions_m
            + now.velocities_m_s * seconds
            + acceleration * (time_constant_s * (seconds - integral_s)),
            velocities_m_s=now.velocities_m_s + acceleration * integral_s,
            accelerations_m_s2=acceleration * decay,
            orientations=_rotation.product(rotation, now.orientations),
        )
        return Snapshot(self.message, self.ahead_s + seconds, predicted)

    def predicted_to(self, time_ns: int) -> Snapshot:
        """The snapshot predicted to a server time, such as ``client.clock_offset().server_now_ns()``."""
        return self.predicted((time_ns - self.pose_time_ns) * 1e-9)


@dataclass(frozen=True)
class Disconnected:
    """The connection is lost, or an attempt to restore it failed. The next attempt follows."""

    reason: str
    tries: int
    """Failed attempts since the loss or since the start; 0 for the loss itself."""
    retry_in_s: float


@dataclass(frozen=True)
class Reconnected:
    """The connection is back; the next update is a snapshot."""

    missed: int | None
    """Snapshots that the server published during the gap; None if it was restarted."""
    restarted: bool
    """Whether the server was restarted. A restarted server assigns new ids; names and codes stay."""
    gap_s: float
    """Time from the last snapshot before the loss to the first one after it, by this machine's clock."""


Update = Snapshot | Disconnected | Reconnected


def _stage(value: int) -> LifeStage:
    try:
        return LifeStage(value)
    except ValueError:
        # A stage that a newer server has added.
        return LifeStage.UNSPECIFIED


def _index_of(values: Sequence[object], value: object) -> int | None:
    # An empty name means no name and matches no object.
    return values.index(value) if value != "" and value in values else None


def _vectors(objects: Iterable[v1.ObjectState], of: Callable[[v1.ObjectState], v1.Vector3]) -> Floats:
    vectors = (of(state) for state in objects)
    return np.array([(v.x, v.y, v.z) for v in vectors], dtype=np.float64).reshape(-1, 3)


def _symmetric(
    triangles: Sequence[Sequence[float]], size: int, indices: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> Floats | None:
    if any(len(triangle) != len(indices[0]) for triangle in triangles):
        return None
    full = np.zeros((len(triangles), size, size))
    if triangles:
        values = np.array(triangles, dtype=np.float64)
        full[:, indices[0], indices[1]] = values
        full[:, indices[1], indices[0]] = values
    return full
