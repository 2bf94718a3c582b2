"""Follows one robot, by its name, the code on its roundel or its id, and prints where it is.

    cargo run --release -- demo                      # in one terminal
    python client/python/examples/follow.py 3        # in another

Names and codes outlast a start of the server; an id is another robot's after that.
"""

from __future__ import annotations

import argparse
import sys

from roundel import Client, Disconnected, LifeStage, Reconnected, Robot, RoundelError, Subscription, v1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", help="a configured name, #N for the one with code N, or an id")
    parser.add_argument("server", nargs="?", default="http://127.0.0.1:7670")
    arguments = parser.parse_args()
    word = arguments.robot
    with Client.connect(arguments.server) as client:
        tell_who_is_there(client, word)
        is_there = True
        with client.updates(wanted(word)) as updates:
            for update in updates:
                if isinstance(update, Disconnected):
                    print(f"lost the server ({update.reason}); next try in {update.retry_in_s:.1f} s", file=sys.stderr)
                elif isinstance(update, Reconnected):
                    missed = "started anew" if update.restarted else f"missed {update.missed}"
                    print(f"back after {update.gap_s:.1f} s, {missed}", file=sys.stderr)
                    if update.restarted and word.isdecimal():
                        sys.exit(f"which robot {word} was, nobody knows any more; give its name or its code")
                elif len(update):
                    is_there = True
                    print(line(update[0]), flush=True)
                elif is_there:
                    is_there = False
                    print(f"{word} is not there", flush=True)


def wanted(word: str) -> Subscription:
    """The robot of that name, code or id."""
    if word.startswith("#") and word[1:].isdecimal():
        return Subscription(codes=[int(word[1:])], max_rate_hz=10.0)
    if word.isdecimal():
        return Subscription(ids=[int(word)], max_rate_hz=10.0)
    return Subscription(names=[word], max_rate_hz=10.0)


def tell_who_is_there(client: Client, word: str) -> None:
    """Says who else there is if this one is not there yet; it is followed as soon as it is."""
    objects = [one for one in client.objects() if one.stage != v1.LIFE_STAGE_LOST]
    if not any(word in (one.name, code(one), str(one.object_id)) for one in objects):
        known = [one.name or code(one) or str(one.object_id) for one in objects]
        print(f"{word} is not seen yet; there are {known}", file=sys.stderr)


def code(one: v1.Object) -> str:
    """As it is asked for; empty without one."""
    return f"#{one.code.number}" if one.HasField("code") else ""


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
