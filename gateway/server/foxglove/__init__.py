"""The Foxglove door: the Foxglove WebSocket protocol v1, under both of its subprotocol names. It only reads."""

from gateway.server.foxglove.door import websocket
from gateway.server.foxglove.messages import SUBPROTOCOLS

__all__ = ["SUBPROTOCOLS", "websocket"]
