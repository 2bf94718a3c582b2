"""State of a stream's connection, for programs that must know whether their data is current."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from roundel.errors import RoundelError


class LinkState(enum.Enum):
    """State of a stream's connection."""

    CONNECTING = "connecting"
    """No snapshot has arrived yet."""
    CONNECTED = "connected"
    """Snapshots arrive; the age of the newest one tells how recently."""
    LOST = "lost"
    """The connection is lost and being retried."""
    ENDED = "ended"
    """Closed, or rejected by the server. No more snapshots will arrive."""


@dataclass(frozen=True)
class Link:
    """State of a stream's connection at one instant."""

    state: LinkState = LinkState.CONNECTING
    error: RoundelError | None = None
    """The last error, also after recovery; None before any."""
    tries: int = 0
    """Failed attempts since the loss or since the start; 0 right after a loss."""
    losses: int = 0
    """Lost connections that had delivered snapshots."""
    restarts: int = 0
    """Server restarts noticed so far. A restarted server assigns new ids."""

    @property
    def is_up(self) -> bool:
        """Whether snapshots arrive."""
        return self.state is LinkState.CONNECTED

    def __str__(self) -> str:
        text = f"the connection is {self.state.value}"
        return text if self.is_up or self.error is None else f"{text}: {self.error}"
