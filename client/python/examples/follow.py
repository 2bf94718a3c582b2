"""Follows one robot by name, code or id, and prints its position.

    cargo run --release -- demo                      # in one terminal
    python client/python/examples/follow.py 3        # in another

Names and codes survive a restart of the server; ids do not.
"""

from __future__ import annotations

import argparse
import sys

from roundel import Client, Disconnected, LifeStage, Reconnected, Robot, RoundelError, Subscription, v1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", help="a configured name, #N for code N, or an id")
    parser.add_argument("server", nargs="?", default="http://127.0.0.1:7670")
    arguments = parser.parse_args()
    selector = arguments.robot
    with Client.connect(arguments.server) as client:
        report_if_missing(client, selector)
        is_tracked = True
        with client.updates(subscription_for(selector)) as updates:
            for update in updates:
                if isinstance(update, Disconnected):
                    print(f"connection lost ({update.reason}); next attempt in {update.retry_in_s:.1f} s", file=sys.stderr)
                elif isinstance(update, Reconnected):
                    outcome = "server restarted" if update.restarted else f"missed {update.missed}"
                    print(f"connected again after {update.gap_s:.1f} s, {outcome}", file=sys.stderr)
                    if update.restarted and selector.isdecimal():
                        sys.exit(f"the restarted server assigns new ids, so robot {selector} is unknown; use its name or code")
                elif len(update):
                    is_tracked = True
                    print(line(update[0]), flush=True)
                elif is_tracked:
                    is_tracked = False
                    print(f"{selector} is not tracked", flush=True)


def subscription_for(selector: str) -> Subscription:
    if selector.startswith("#") and selector[1:].isdecimal():
        return Subscription(codes=[int(selector[1:])], max_rate_hz=10.0)
    if selector.isdecimal():
        return Subscription(ids=[int(selector)], max_rate_hz=10.0)
    return Subscription(names=[selector], max_rate_hz=10.0)


def report_if_missing(client: Client, selector: str) -> None:
    """Lists the tracked robots if this one is not among them. It is followed as soon as it is tracked."""
    objects = [each for each in client.objects() if each.stage != v1.LIFE_STAGE_LOST]
    if not any(selector in (each.name, code(each), str(each.object_id)) for each in objects):
        tracked = [each.name or code(each) or str(each.object_id) for each in objects]
        print(f"{selector} is not tracked yet; tracked are {tracked}", file=sys.stderr)


def code(robot: v1.Object) -> str:
    """The code as a selector; empty without one."""
    return f"#{robot.code.number}" if robot.HasField("code") else ""


def line(robot: Robot) -> str:
    (x, y, z), (vx, vy, vz) = robot.position_m, robot.velocity_m_s
    sigma_mm = [0.0] * 3 if robot.position_sigma_m is None else robot.position_sigma_m * 1e3
    stage = "seen" if robot.stage is LifeStage.TRACKED else "predicted"
    return (
        f"{x:8.3f} {y:8.3f} {z:8.3f} m  {vx:6.2f} {vy:6.2f} {vz:6.2f} m/s  "
        f"sigma {sigma_mm[0]:4.1f} {sigma_mm[1]:4.1f} {sigma_mm[2]:4.1f} mm  {stage}"
    )


if __name__ == "__main__":
    try:
        main()
    except RoundelError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        pass
