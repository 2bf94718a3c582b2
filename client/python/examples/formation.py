"""A closed control loop: drives simulated robots into a circle, pushes one away, and restores the circle.

    cargo run --release -- demo --robots 12              # in one terminal
    python client/python/examples/formation.py           # in another

Every 50 ms, the loop predicts the newest poses to the time at which a command takes effect, and commands each robot towards
its place on the circle and away from robots nearby. Ends with an error if the circle is not reached, if the push moves no
robot, or if no recent snapshot arrives. Robots without commands stop automatically.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from numpy.typing import NDArray

from roundel import Client, Latest, RoundelError, Snapshot, Stale

Floats = NDArray[np.float64]

PERIOD_S = 0.05
COMMAND_DELAY_S = 0.05
"""Time from a command until it takes effect."""
GAIN_HZ = 1.0
"""Velocity per metre of position error. The robots reach a commanded velocity within half a second; more gain would oscillate."""
TOP_SPEED_M_S = 0.9
AVOIDANCE_DISTANCE_M = 0.6
"""Robots closer than this avoid each other."""
AVOIDANCE_GAIN_HZ = 1.5
TOLERANCE_M = 0.03
"""RMS position error at which the circle counts as reached."""
SETTLED_S = 2.0
MIN_PUSH_M = 0.3
"""Minimum displacement by the push, which moves a robot at 1 m/s for a second against its control loop."""
TIMEOUT_S = 60.0
MAX_AGE_S = 2.0
"""Limit for the age of a snapshot and for the duration of a call."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--server", default="http://127.0.0.1:7670")
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--radius", type=float, default=2.0, help="radius of the circle, metres")
    arguments = parser.parse_args()
    with Client.connect(arguments.server, timeout_s=MAX_AGE_S) as client, client.latest() as latest:
        formation = Formation(client, arguments.robots, arguments.radius)
        formation.assign(wait_for(latest, arguments.robots))
        formed_s = formation.hold(latest, "forming")
        pushed = formation.ids[0]
        outwards = formation.targets_m[0] / arguments.radius
        client.push(pushed, outwards, duration_s=1.0)
        print(f"pushing robot {pushed} away", flush=True)
        back_s = formation.hold(latest, "holding", least_s=3.0)
        if formation.worst_m[0] < MIN_PUSH_M:
            sys.exit(
                f"expected the push to take robot {pushed} at least {MIN_PUSH_M} m away, found {formation.worst_m[0]:.2f} m"
            )
        print(
            f"formed in {formed_s:.1f} s, again {back_s:.1f} s after the push, which took robot {pushed} "
            f"{formation.worst_m[0]:.2f} m away and the others {formation.worst_m[1:].max():.3f} m; "
            f"rms {formation.rms_m * 1e3:.1f} mm"
        )


def wait_for(latest: Latest, robots: int) -> Snapshot:
    """The first snapshot in which enough robots are observed."""
    end = time.monotonic() + TIMEOUT_S
    tracked = 0
    while time.monotonic() < end:
        try:
            snapshot = latest.next(MAX_AGE_S)
        except Stale:
            # A server publishes no snapshot before its first observation.
            continue
        tracked = int(snapshot.tracked.sum())
        if tracked >= robots:
            return snapshot
    sys.exit(f"expected {robots} observed robots within {TIMEOUT_S:.0f} s, found {tracked}; {latest.link}")


class Formation:
    """Robots and their target positions on a circle."""

    def __init__(self, client: Client, robots: int, radius_m: float) -> None:
        self.client = client
        self.clock = client.clock_offset()
        angles = np.arange(robots) * (2.0 * np.pi / robots)
        self.targets_m: Floats = radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        self.ids: list[int] = []
        self.rms_m = float("inf")
        self.worst_m: Floats = np.zeros(robots)
        """Largest position error of each robot during the current `hold`."""

    def assign(self, snapshot: Snapshot) -> None:
        """Assigns targets in the order of the robots' bearings from their centroid, so that paths rarely cross."""
        rows = np.flatnonzero(snapshot.tracked)[: len(self.targets_m)]
        at_m = snapshot.positions_m[rows, :2]
        around = at_m - at_m.mean(axis=0)
        order = np.argsort(np.arctan2(around[:, 1], around[:, 0]))
        rows, at_m = rows[order], at_m[order]
        shifts = range(len(rows))
        best = min(shifts, key=lambda shift: float(((np.roll(at_m, shift, axis=0) - self.targets_m) ** 2).sum()))
        self.ids = [int(i) for i in snapshot.ids[np.roll(rows, best)]]

    def hold(self, latest: Latest, phase: str, least_s: float = 0.0) -> float:
        """Drives until the circle has been kept for `SETTLED_S`. Returns the time until it was reached."""
        begin = time.monotonic()
        settled_since: float | None = None
        reported = begin
        self.worst_m[:] = 0.0
        while True:
            now = time.monotonic()
            snapshot = latest.next(MAX_AGE_S)
            error_m = self.step(snapshot)
            self.worst_m = np.maximum(self.worst_m, error_m)
            self.rms_m = float(np.sqrt((error_m**2).mean()))
            is_settled = self.rms_m <= TOLERANCE_M
            settled_since = (settled_since or now) if is_settled else None
            if now - reported >= 1.0:
                reported = now
                print(f"{now - begin:5.1f} s  {phase}: rms {self.rms_m * 1e3:6.1f} mm", flush=True)
            if settled_since and now - settled_since >= SETTLED_S and now - begin >= least_s:
                return settled_since - begin
            if now - begin > TIMEOUT_S:
                sys.exit(f"{phase}: expected rms {TOLERANCE_M * 1e3:.0f} mm within {TIMEOUT_S:.0f} s, found {self.rms_m * 1e3:.1f}")
            time.sleep(max(0.0, PERIOD_S - (time.monotonic() - now)))

    def step(self, snapshot: Snapshot) -> Floats:
        """Commands all robots. Returns their position errors, metres."""
        ahead = snapshot.predicted_to(self.clock.server_now_ns() + round(COMMAND_DELAY_S * 1e9))
        rows = [ahead.index(object_id) for object_id in self.ids]
        lost = [object_id for object_id, row in zip(self.ids, rows) if row is None]
        if lost:
            sys.exit(f"the server no longer tracks robots {lost}")
        rows_array = np.array(rows)
        at_m = ahead.positions_m[rows_array, :2]
        velocities = GAIN_HZ * (self.targets_m - at_m) + avoidance(at_m)
        speeds = np.linalg.norm(velocities, axis=1, keepdims=True)
        velocities *= np.minimum(1.0, TOP_SPEED_M_S / np.maximum(speeds, 1e-9))
        # Predicted positions may be wrong, so robots that are not observed get no commands, and stop.
        observed = snapshot.tracked[rows_array]
        self.client.drive({robot: v for robot, v, ok in zip(self.ids, velocities.tolist(), observed) if ok})
        now_m = snapshot.positions_m[rows_array, :2]
        error_m: Floats = np.linalg.norm(now_m - self.targets_m, axis=1)
        return error_m


def avoidance(at_m: Floats) -> Floats:
    """Velocities away from robots nearby."""
    offsets_m = at_m[:, None] - at_m[None, :]
    distance_m = np.linalg.norm(offsets_m, axis=-1)
    np.fill_diagonal(distance_m, np.inf)
    strength = np.maximum(0.0, AVOIDANCE_DISTANCE_M - distance_m) * AVOIDANCE_GAIN_HZ / np.maximum(distance_m, 0.05)
    velocities: Floats = (offsets_m * strength[..., None]).sum(axis=1)
    return velocities


if __name__ == "__main__":
    try:
        main()
    except RoundelError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        pass
