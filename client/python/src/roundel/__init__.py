"""Client for Roundel servers: live poses of every tracked robot.

    from roundel import Client, Subscription

    with Client.connect("http://127.0.0.1:7670") as client:
        for snapshot in client.snapshots(Subscription(names=["cart"])):
            print(snapshot.position_m("cart"))

A client may be used from several threads, but only `close` of an iterator may be called from another thread than its
reader. Once a client is closed, its calls raise `Closed` and its iterators end.

:mod:`roundel.aio` has the same client for asyncio, :mod:`roundel.v1` the messages of the .proto files.
"""

from roundel.client import Client, Latest, Snapshots
from roundel.clock import ClockOffset
from roundel.errors import (
    Closed,
    Conflict,
    InvalidAddress,
    NotRoundel,
    PermissionDenied,
    Refused,
    RoundelError,
    ServerError,
    Stale,
    TimedOut,
    Unauthenticated,
    Unreachable,
    Untrusted,
    WrongFingerprint,
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
    "PermissionDenied",
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
    "Unauthenticated",
    "Unreachable",
    "Untrusted",
    "Update",
    "WrongFingerprint",
]
