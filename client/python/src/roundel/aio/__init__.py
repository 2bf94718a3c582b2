"""The client for asyncio: calls are awaited, streams are read with `async for`.

A client is created and used within one event loop. Its streams end when they or the client are closed, and calls raise
`Closed` from then on.
"""

from roundel.aio.client import Client, Latest, Snapshots

__all__ = ["Client", "Latest", "Snapshots"]
