"""Every object at one instant, as NumPy arrays.

Row i of each array is the same object. Frames, units and signs are those of the .proto files: world frame, metres,
radians, seconds; quaternions x y z w; times in ns since the Unix epoch.
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

ACCELERATION_LASTS_S = 0.4
"""How long an acceleration lasts: after t seconds exp(-t / 0.4 s) of it is left."""

_TRIANGLE_6 = np.triu_indices(6)
_TRIANGLE_3 = np.triu_indices(3)


class LifeStage(enum.IntEnum):
    """How sure the server is of an object."""

    UNSPECIFIED = 0
    TENTATIVE = 1
    """Seen too seldom yet to be trusted."""
    TRACKED = 2
    """Observed now."""
    PREDICTED = 3
    """Not observed now; the pose is the motion model's."""
    LOST = 4
    """Given up."""


@dataclass(frozen=True)
class Robot:
    """One object of a snapshot."""

    object_id: int
    name: str
    roundel: str
    """Kind of roundel."""
    code: int | None
    """Number that its teeth say, where it is coded and was read."""
    stage: LifeStage
    position_m: Floats
    velocity_m_s: Floats
    orientation: Floats
    """world_from_object, quaternion x y z w."""
    yaw_observed: bool
    age_ns: int
    """Pose time less the capture time of the newest observation used."""
    covariance: Floats | None
    """6x6 over (position m, rotation rad); None where it was left out."""

    @property
    def yaw_rad(self) -> float | None:
        """Angle of its x axis about the world's z axis, anticlockwise from the world's x; None while it is not observed."""
        if not self.yaw_observed:
            return None
        x, y, z, w = self.orientation
        return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))

    @property
    def speed_m_s(self) -> float:
        """Length of the velocity."""
        return float(np.linalg.norm(self.velocity_m_s))

    @property
    def position_sigma_m(self) -> Floats | None:
        """Standard deviations of the position along the world's axes."""
        if self.covariance is None:
            return None
        sigmas: Floats = np.sqrt(np.clip(np.diagonal(self.covariance)[:3], 0.0, None))
        return sigmas


@dataclass(frozen=True)
class _Motion:
    """What prediction changes."""

    positions_m: Floats
    velocities_m_s: Floats
    accelerations_m_s2: Floats
    orientations: Floats


@dataclass(frozen=True)
class Snapshot:
    """Every object that was asked for, at `pose_time_ns`. Arrays are made when they are first asked for."""

    message: v1.Snapshot
    """As it came."""
    ahead_s: float = 0.0
    """How far this client has predicted it past the time that the server gave it."""
    _motion: _Motion | None = field(default=None, repr=False, compare=False)

    @property
    def sequence(self) -> int:
        """Grows by one with each snapshot of this server."""
        return self.message.sequence

    @property
    def source_id(self) -> str:
        """Tells two servers, and two runs of one server, apart."""
        return self.message.source_id

    @property
    def missed(self) -> int:
        """Snapshots that this client wanted but was too slow for, since the one before."""
        return self.message.missed

    @property
    def pose_time_ns(self) -> int:
        """The instant that every object is given for."""
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
        """Configured names; empty where there is none."""
        return [o.name for o in self.message.objects]

    @functools.cached_property
    def codes(self) -> list[int | None]:
        """Numbers of the codes; None where a roundel has none, or was not read yet."""
        return [o.code.number if o.HasField("code") else None for o in self.message.objects]

    @property
    def tracked(self) -> NDArray[np.bool_]:
        """Which objects are observed now, shape (n,): of the others the poses are expected ones."""
        mask: NDArray[np.bool_] = self.stages == LifeStage.TRACKED
        return mask

    @functools.cached_property
    def stages(self) -> NDArray[np.int64]:
        """Values of :class:`LifeStage`, shape (n,)."""
        return np.array([o.stage for o in self.message.objects], dtype=np.int64)

    @functools.cached_property
    def yaw_observed(self) -> NDArray[np.bool_]:
        """Where it is false the rotation about the roundel's normal is a convention; shape (n,)."""
        return np.array([o.yaw_observed for o in self.message.objects], dtype=np.bool_)

    @functools.cached_property
    def _moves(self) -> _Motion:
        if self._motion is not None:
            return self._motion
        objects = self.message.objects
        return _Motion(
            positions_m=_vectors(objects, lambda o: o.position),
            velocities_m_s=_vectors(objects, lambda o: o.velocity),
            accelerations_m_s2=_vectors(objects, lambda o: o.acceleration),
            orientations=np.array(
                [(q.x, q.y, q.z, q.w) for q in (o.orientation for o in objects)], dtype=np.float64
            ).reshape(-1, 4),
        )

    @property
    def positions_m(self) -> Floats:
        """Tracked points, shape (n, 3)."""
        return self._moves.positions_m

    @property
    def velocities_m_s(self) -> Floats:
        """Shape (n, 3)."""
        return self._moves.velocities_m_s

    @property
    def accelerations_m_s2(self) -> Floats:
        """Shape (n, 3); 0 where covariances were left out, and of servers that do not say it."""
        return self._moves.accelerations_m_s2

    @property
    def orientations(self) -> Floats:
        """world_from_object, quaternions x y z w, shape (n, 4)."""
        return self._moves.orientations

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
        """Of (position m, rotation rad), shape (n, 6, 6).

        None where they were left out, and of a snapshot that this client has predicted: the server knows how
        uncertainty grows, and says it when asked for a `horizon_s`.
        """
        if self.ahead_s != 0.0:
            return None
        return _symmetric([o.covariance for o in self.message.objects], 6, _TRIANGLE_6)

    @functools.cached_property
    def velocity_covariances(self) -> Floats | None:
        """(m/s)^2, shape (n, 3, 3); None as of :attr:`covariances`."""
        if self.ahead_s != 0.0:
            return None
        return _symmetric([o.velocity_covariance for o in self.message.objects], 3, _TRIANGLE_3)

    def index(self, object_id: int) -> int | None:
        """The row of an object, or None if it is not in this snapshot."""
        rows = np.flatnonzero(self.ids == object_id)
        return int(rows[0]) if len(rows) else None

    def robot(self, which: int | str) -> Robot | None:
        """One object, by object_id or by name; None if it is not in this snapshot."""
        row = _place(self.names, which) if isinstance(which, str) else self.index(which)
        return None if row is None else self[row]

    def coded(self, number: int) -> Robot | None:
        """The object whose roundel has this code; None if it is not in this snapshot."""
        row = _place(self.codes, number)
        return None if row is None else self[row]

    def position_m(self, which: int | str) -> Floats | None:
        """Where one object is, by object_id or by name, shape (3,); None if it is not in this snapshot."""
        robot = self.robot(which)
        return None if robot is None else robot.position_m

    def __getitem__(self, row: int) -> Robot:
        one = self.message.objects[row]
        return Robot(
            object_id=one.object_id,
            name=one.name,
            roundel=one.roundel,
            code=self.codes[row],
            stage=_stage(one.stage),
            position_m=self.positions_m[row],
            velocity_m_s=self.velocities_m_s[row],
            orientation=self.orientations[row],
            yaw_observed=one.yaw_observed,
            age_ns=one.observation_age_ns + round(self.ahead_s * 1e9),
            covariance=None if self.covariances is None else self.covariances[row],
        )

    def predicted(self, seconds: float) -> Snapshot:
        """The same so many seconds later, as the server's own prediction has it.

        Accelerations fade as exp(-t / L), L = 0.4 s: velocities grow by a L (1 - e), positions by
        v t + a L (t - L (1 - e)), e = exp(-t / L). Objects turn on with their angular velocity.

        A subscription without covariances (``covariance=False``) gets no accelerations either: what it got is predicted by
        velocities alone, and not as the server does it. A `horizon_s` of the subscription has the server predict.
        """
        if not np.isfinite(seconds):
            raise ValueError(f"expected a finite number of seconds, found {seconds}")
        lasts_s, moves = ACCELERATION_LASTS_S, self._moves
        left = float(np.exp(-seconds / lasts_s))
        grown_s = lasts_s * (1.0 - left)
        acceleration = moves.accelerations_m_s2
        turn = _rotation.from_rotation_vector(self.angular_velocities_rad_s * seconds)
        motion = _Motion(
            positions_m=moves.positions_m
            + moves.velocities_m_s * seconds
            + acceleration * (lasts_s * (seconds - grown_s)),
            velocities_m_s=moves.velocities_m_s + acceleration * grown_s,
            accelerations_m_s2=acceleration * left,
            orientations=_rotation.product(turn, moves.orientations),
        )
        return Snapshot(self.message, self.ahead_s + seconds, motion)

    def predicted_to(self, time_ns: int) -> Snapshot:
        """The same at an instant of the server's clock, such as ``client.clock_offset().server_now_ns()``."""
        return self.predicted((time_ns - self.pose_time_ns) * 1e-9)


@dataclass(frozen=True)
class Disconnected:
    """The connection is lost, or the try to get it back failed; the next try follows."""

    reason: str
    tries: int
    """That have failed since the loss or the begin: 0 for the loss itself, 1 for the first try after it or of all."""
    retry_in_s: float


@dataclass(frozen=True)
class Reconnected:
    """The connection is back; the next update is a snapshot."""

    missed: int | None
    """Snapshots that the server made meanwhile; None if it was started anew."""
    restarted: bool
    """The server was started anew: ids begin anew too, so robots are to be found again by name or code."""
    gap_s: float
    """From the last snapshot before the loss to the first one after it, by this machine's clock."""


Update = Snapshot | Disconnected | Reconnected


def _stage(value: int) -> LifeStage:
    try:
        return LifeStage(value)
    except ValueError:
        # Of a newer server.
        return LifeStage.UNSPECIFIED


def _place(values: Sequence[object], wanted: object) -> int | None:
    # Objects without a name have an empty one: it is nobody's.
    return values.index(wanted) if wanted != "" and wanted in values else None


def _vectors(objects: Iterable[v1.ObjectState], of: Callable[[v1.ObjectState], v1.Vector3]) -> Floats:
    vectors = (of(one) for one in objects)
    return np.array([(v.x, v.y, v.z) for v in vectors], dtype=np.float64).reshape(-1, 3)


def _symmetric(
    triangles: Sequence[Sequence[float]], size: int, places: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> Floats | None:
    if any(len(triangle) != len(places[0]) for triangle in triangles):
        return None
    full = np.zeros((len(triangles), size, size))
    if triangles:
        values = np.array(triangles, dtype=np.float64)
        full[:, places[0], places[1]] = values
        full[:, places[1], places[0]] = values
    return full
