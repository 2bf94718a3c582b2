"""Client for Roundel servers: where every robot is, live.

    from roundel import Client, Subscription

    with Client.connect("http://127.0.0.1:7670") as client:
        for snapshot in client.snapshots(Subscription(ids=[3])):
            print(snapshot.positions_m)

:mod:`roundel.aio` has the same for asyncio; :mod:`roundel.v1` the messages of the .proto files.
"""

from roundel.client import Client, Latest, Snapshots
from roundel.clock import ClockOffset
from roundel.errors import Conflict, InvalidAddress, NotRoundel, Refused, RoundelError, ServerError, Unreachable
from roundel.snapshot import Disconnected, LifeStage, Reconnected, Robot, Snapshot, Update
from roundel.subscription import Subscription

__all__ = [
    "Client",
    "ClockOffset",
    "Conflict",
    "Disconnected",
    "InvalidAddress",
    "Latest",
    "LifeStage",
    "NotRoundel",
    "Reconnected",
    "Refused",
    "Robot",
    "RoundelError",
    "ServerError",
    "Snapshot",
    "Snapshots",
    "Subscription",
    "Unreachable",
    "Update",
]
