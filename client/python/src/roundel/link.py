"""How a stream's connection is, for programs that must know whether what they have is news."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from roundel.errors import RoundelError


class LinkState(enum.Enum):
    """How the connection of a stream is."""

    CONNECTING = "connecting"
    """No snapshot has come yet."""
    CONNECTED = "connected"
    """Snapshots come, as far as is known: see the age of the newest one."""
    LOST = "lost"
    """There is none; it is tried again and again."""
    ENDED = "ended"
    """Closed, or refused by the server: nothing will come any more."""


@dataclass(frozen=True)
class Link:
    """How the connection of a stream is, at one instant."""

    state: LinkState = LinkState.CONNECTING
    error: RoundelError | None = None
    """The last one there was, also after it has healed; None before any."""
    tries: int = 0
    """In vain, since the loss or the begin; 0 while a loss is all that happened."""
    losses: int = 0
    """Of connections that had brought snapshots."""
    restarts: int = 0
    """Times that the server was found started anew, with ids that begin anew."""

    @property
    def is_up(self) -> bool:
        """Whether snapshots come, as far as is known."""
        return self.state is LinkState.CONNECTED

    def __str__(self) -> str:
        told = f"the connection is {self.state.value}"
        return told if self.is_up or self.error is None else f"{told}: {self.error}"
