"""Client for Roundel servers: where every robot is, live.

    from roundel import Client, Subscription

    with Client.connect("http://127.0.0.1:7670") as client:
        for snapshot in client.snapshots(Subscription(names=["cart"])):
            print(snapshot.position_m("cart"))

:mod:`roundel.aio` has the same for asyncio; :mod:`roundel.v1` the messages of the .proto files.
"""

from roundel.client import Client, Latest, Snapshots
from roundel.clock import ClockOffset
from roundel.errors import (
    Closed,
    Conflict,
    InvalidAddress,
    NotRoundel,
    Refused,
    RoundelError,
    ServerError,
    Stale,
    TimedOut,
    Unreachable,
)
from roundel.history import History, Track
from roundel.link import Link, LinkState
from roundel.snapshot import Disconnected, LifeStage, Reconnected, Robot, Snapshot, Update
from roundel.subscription import Subscription

__all__ = [
    "Client",
    "ClockOffset",
    "Closed",
    "Conflict",
    "Disconnected",
    "History",
    "InvalidAddress",
    "Latest",
    "LifeStage",
    "Link",
    "LinkState",
    "NotRoundel",
    "Reconnected",
    "Refused",
    "Robot",
    "RoundelError",
    "ServerError",
    "Snapshot",
    "Snapshots",
    "Stale",
    "Subscription",
    "TimedOut",
    "Track",
    "Unreachable",
    "Update",
]
