"""Follows one robot, by its id, its name or the code on its roundel, and prints where it is.

    cargo run --release -- demo                      # in one terminal
    python client/python/examples/follow.py 3        # in another; '#12' for code 12
"""

from __future__ import annotations

import argparse
import sys

from roundel import Client, Disconnected, LifeStage, Reconnected, Robot, RoundelError, Subscription


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", help="an id, a configured name, or #N for the one with code N")
    parser.add_argument("server", nargs="?", default="http://127.0.0.1:7670")
    arguments = parser.parse_args()
    with Client.connect(arguments.server) as client:
        object_id = find(client, arguments.robot)
        is_there = True
        with client.updates(Subscription(ids=[object_id], max_rate_hz=10.0)) as updates:
            for update in updates:
                if isinstance(update, Disconnected):
                    print(f"lost the server ({update.reason}); next try in {update.retry_in_s:.1f} s", file=sys.stderr)
                elif isinstance(update, Reconnected):
                    if update.missed is None:
                        # Ids are given anew by a new server, so the same number may be another robot.
                        sys.exit("the server was started anew")
                    print(f"back, missed {update.missed}", file=sys.stderr)
                elif robot := update.robot(object_id):
                    is_there = True
                    print(line(robot), flush=True)
                elif is_there:
                    is_there = False
                    print(f"{arguments.robot} is not there", flush=True)


def find(client: Client, word: str) -> int:
    """The id of the robot of that id, name or code."""
    if word.isdecimal():
        return int(word)
    names = {}
    for one in client.objects():
        names[f"#{one.code.number}" if one.HasField("code") else one.name] = one.object_id
        names[one.name] = one.object_id
    if word not in names:
        sys.exit(f"no robot has the name or code {word!r}; there are {sorted(filter(None, names))}")
    return names[word]


def line(robot: Robot) -> str:
    (x, y, z), (vx, vy, vz) = robot.position_m, robot.velocity_m_s
    sigma_mm = [0.0] * 3 if robot.position_sigma_m is None else robot.position_sigma_m * 1e3
    seen = "seen" if robot.stage is LifeStage.TRACKED else "predicted"
    return (
        f"{x:8.3f} {y:8.3f} {z:8.3f} m  {vx:6.2f} {vy:6.2f} {vz:6.2f} m/s  "
        f"sigma {sigma_mm[0]:4.1f} {sigma_mm[1]:4.1f} {sigma_mm[2]:4.1f} mm  {seen}"
    )


if __name__ == "__main__":
    try:
        main()
    except RoundelError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        pass
