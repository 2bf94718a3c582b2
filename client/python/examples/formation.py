"""Drives simulated robots into a circle, pushes one away, and has them keep the circle: a closed control loop.

    cargo run --release -- demo --robots 12              # in one terminal
    python client/python/examples/formation.py           # in another

Every 50 ms: the newest poses are predicted to when the robots will obey, each robot is drawn to its place on the circle
and away from whoever is near, and told so. Ends with an error if the circle is not as wanted, if the push moved
nobody, and as soon as there is no news of where the robots are: they stop by themselves when they are told nothing.
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
OBEYED_AFTER_S = 0.05
"""From a command until robots obey it."""
GAIN_HZ = 1.0
"""Velocity for each metre off the place. The robots follow a command within half a second: more would swing."""
TOP_SPEED_M_S = 0.9
NEAR_M = 0.6
"""Robots nearer than this give way to each other."""
GIVE_WAY_HZ = 1.5
GOOD_M = 0.03
"""Root mean square distance from the places at which the circle stands."""
SETTLED_S = 2.0
PUSHED_M = 0.3
"""So far the push must take its robot at least: it moves at 1 m/s for a second, and draws back meanwhile."""
PATIENCE_S = 60.0
BLIND_S = 2.0
"""Nobody is driven by what is older, nor waited for longer with an answer."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--server", default="http://127.0.0.1:7670")
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--radius", type=float, default=2.0, help="of the circle, metres")
    arguments = parser.parse_args()
    with Client.connect(arguments.server, timeout_s=BLIND_S) as client, client.latest() as latest:
        formation = Formation(client, arguments.robots, arguments.radius)
        formation.assign(wait_for(latest, arguments.robots))
        formed_s = formation.hold(latest, "forming")
        pushed = formation.ids[0]
        outwards = formation.places_m[0] / arguments.radius
        client.push(pushed, outwards, duration_s=1.0)
        print(f"pushing robot {pushed} away", flush=True)
        back_s = formation.hold(latest, "holding", least_s=3.0)
        if formation.worst_m[0] < PUSHED_M:
            sys.exit(
                f"expected the push to take robot {pushed} at least {PUSHED_M} m away, found {formation.worst_m[0]:.2f} m"
            )
        print(
            f"formed in {formed_s:.1f} s, again {back_s:.1f} s after the push, which took robot {pushed} "
            f"{formation.worst_m[0]:.2f} m away and the others {formation.worst_m[1:].max():.3f} m; "
            f"rms {formation.rms_m * 1e3:.1f} mm"
        )


def wait_for(latest: Latest, robots: int) -> Snapshot:
    """The first snapshot with enough robots that are seen."""
    end = time.monotonic() + PATIENCE_S
    tracked = 0
    while time.monotonic() < end:
        try:
            snapshot = latest.next(BLIND_S)
        except Stale:
            # A server that has just begun makes none before it has seen something.
            continue
        tracked = int(snapshot.tracked.sum())
        if tracked >= robots:
            return snapshot
    sys.exit(f"expected {robots} robots to be seen within {PATIENCE_S:.0f} s, found {tracked}; {latest.link}")


class Formation:
    """Robots and their places on a circle."""

    def __init__(self, client: Client, robots: int, radius_m: float) -> None:
        self.client = client
        self.clock = client.clock_offset()
        angles = np.arange(robots) * (2.0 * np.pi / robots)
        self.places_m: Floats = radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        self.ids: list[int] = []
        self.rms_m = float("inf")
        self.worst_m: Floats = np.zeros(robots)
        """Farthest that each robot was from its place, since the circle stood."""

    def assign(self, snapshot: Snapshot) -> None:
        """Gives each robot a place: in the order in which they stand round the middle, so that ways hardly cross."""
        rows = np.flatnonzero(snapshot.tracked)[: len(self.places_m)]
        at_m = snapshot.positions_m[rows, :2]
        around = at_m - at_m.mean(axis=0)
        order = np.argsort(np.arctan2(around[:, 1], around[:, 0]))
        rows, at_m = rows[order], at_m[order]
        turns = range(len(rows))
        best = min(turns, key=lambda turn: float(((np.roll(at_m, turn, axis=0) - self.places_m) ** 2).sum()))
        self.ids = [int(i) for i in snapshot.ids[np.roll(rows, best)]]

    def hold(self, latest: Latest, word: str, least_s: float = 0.0) -> float:
        """Drives until the circle has stood for a while; how long it took until then."""
        begin = time.monotonic()
        good_since: float | None = None
        told = begin
        self.worst_m[:] = 0.0
        while True:
            now = time.monotonic()
            snapshot = latest.next(BLIND_S)
            off_m = self.step(snapshot)
            self.worst_m = np.maximum(self.worst_m, off_m)
            self.rms_m = float(np.sqrt((off_m**2).mean()))
            is_good = self.rms_m <= GOOD_M
            good_since = (good_since or now) if is_good else None
            if now - told >= 1.0:
                told = now
                print(f"{now - begin:5.1f} s  {word}: rms {self.rms_m * 1e3:6.1f} mm", flush=True)
            if good_since and now - good_since >= SETTLED_S and now - begin >= least_s:
                return good_since - begin
            if now - begin > PATIENCE_S:
                sys.exit(f"{word}: expected rms {GOOD_M * 1e3:.0f} mm within {PATIENCE_S:.0f} s, found {self.rms_m * 1e3:.1f}")
            time.sleep(max(0.0, PERIOD_S - (time.monotonic() - now)))

    def step(self, snapshot: Snapshot) -> Floats:
        """Tells all robots how to move; how far each one is from its place, metres."""
        ahead = snapshot.predicted_to(self.clock.server_now_ns() + round(OBEYED_AFTER_S * 1e9))
        rows = [ahead.index(object_id) for object_id in self.ids]
        lost = [object_id for object_id, row in zip(self.ids, rows) if row is None]
        if lost:
            sys.exit(f"the server follows robots {lost} no more")
        places = np.array(rows)
        at_m = ahead.positions_m[places, :2]
        wanted = GAIN_HZ * (self.places_m - at_m) + giving_way(at_m)
        speeds = np.linalg.norm(wanted, axis=1, keepdims=True)
        wanted *= np.minimum(1.0, TOP_SPEED_M_S / np.maximum(speeds, 1e-9))
        # Whoever is not seen may be elsewhere than expected: it is told nothing, and stops if that lasts.
        seen = snapshot.tracked[places]
        self.client.drive({robot: v for robot, v, is_seen in zip(self.ids, wanted.tolist(), seen) if is_seen})
        now_m = snapshot.positions_m[places, :2]
        off_m: Floats = np.linalg.norm(now_m - self.places_m, axis=1)
        return off_m


def giving_way(at_m: Floats) -> Floats:
    """Velocities away from whoever is near."""
    apart = at_m[:, None] - at_m[None, :]
    distance_m = np.linalg.norm(apart, axis=-1)
    np.fill_diagonal(distance_m, np.inf)
    strength = np.maximum(0.0, NEAR_M - distance_m) * GIVE_WAY_HZ / np.maximum(distance_m, 0.05)
    velocities: Floats = (apart * strength[..., None]).sum(axis=1)
    return velocities


if __name__ == "__main__":
    try:
        main()
    except RoundelError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        pass
