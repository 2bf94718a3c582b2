"""Records every robot to a CSV file, with one line for each robot of each snapshot.

    python client/python/examples/record.py run.csv --seconds 10

`sx_m`, `sy_m` and `sz_m` are standard deviations of the position. Reports the number of missed snapshots. A restarted server
assigns new ids and sequence numbers; `source_id` distinguishes the runs.
"""

from __future__ import annotations

import argparse
import csv
import sys
import threading

from roundel import Client, Disconnected, LifeStage, Reconnected, RoundelError, Snapshot, Snapshots, Subscription

COLUMNS = [
    "pose_time_ns", "source_id", "sequence", "object_id", "name", "stage",
    "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s", "qx", "qy", "qz", "qw", "sx_m", "sy_m", "sz_m",
]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", help="output file; - for standard output")
    parser.add_argument("--server", default="http://127.0.0.1:7670")
    parser.add_argument("--seconds", type=float, help="duration of the recording")
    parser.add_argument("--rate", type=float, help="maximum rate of snapshots, Hz")
    arguments = parser.parse_args()
    file = sys.stdout if arguments.file == "-" else open(arguments.file, "w", newline="", encoding="utf-8")
    count = 0
    with file, Client.connect(arguments.server) as client:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        with client.updates(Subscription(max_rate_hz=arguments.rate)) as updates:
            if arguments.seconds is not None:
                close_after(arguments.seconds, updates)
            for update in updates:
                if isinstance(update, Snapshot):
                    writer.writerows(rows(update))
                    count += 1
                elif isinstance(update, Disconnected):
                    print(f"connection lost ({update.reason}); next attempt in {update.retry_in_s:.1f} s", file=sys.stderr)
                elif isinstance(update, Reconnected):
                    outcome = f"missed {update.missed}"
                    if update.restarted:
                        outcome = "server restarted with new ids"
                    print(f"connected again after {update.gap_s:.1f} s, {outcome}", file=sys.stderr)
            print(f"{count} snapshots written, {updates.missed} missed", file=sys.stderr)


def close_after(seconds: float, updates: Snapshots) -> None:
    """Ends the stream after a time, also while no snapshots arrive."""
    timer = threading.Timer(seconds, updates.close)
    timer.daemon = True
    timer.start()


def rows(snapshot: Snapshot) -> list[list[object]]:
    head = [snapshot.pose_time_ns, snapshot.source_id, snapshot.sequence]
    lines: list[list[object]] = []
    for row in range(len(snapshot)):
        robot = snapshot[row]
        numbers = [*robot.position_m, *robot.velocity_m_s, *robot.orientation]
        sigma_m = [""] * 3 if robot.position_sigma_m is None else [f"{s:.6f}" for s in robot.position_sigma_m]
        lines.append([
            *head, robot.object_id, robot.name, LifeStage(robot.stage).name.lower(),
            *(f"{number:.6f}" for number in numbers), *sigma_m,
        ])  # fmt: skip
    return lines


if __name__ == "__main__":
    try:
        main()
    except RoundelError as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        pass
