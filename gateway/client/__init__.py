"""The typed async client of the native protocol: what the command line uses, and anyone may.

`follow` goes on for ever and reconnects by itself; `connect` is one connection. It needs nothing of the gateway's core:
only its message structs.

    async with follow("ws://127.0.0.1:8765/ws") as cell:
        await cell.subscribe(["*/joints", "*/events"], rate_hz=10)
        async for item in cell:
            ...
"""

from __future__ import annotations

from gateway.client.connection import CellInfo, Client, Pushed, RequestError, connect
from gateway.client.following import Connected, Disconnected, Follower, Item, Refused, follow
from gateway.client.typed import typed
from gateway.client.way import ClientError, TrustError, Way, trusting, way_to

__all__ = [
    "CellInfo",
    "Client",
    "ClientError",
    "Connected",
    "Disconnected",
    "Follower",
    "Item",
    "Pushed",
    "Refused",
    "RequestError",
    "TrustError",
    "Way",
    "connect",
    "follow",
    "trusting",
    "typed",
    "way_to",
]
