"""The decoder of a session that must not be dropped: what goes wrong in it is counted and shown, and never ends it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from gateway.api.decoder import Decoder, Event, Frame, Refused, Reject

_Value = TypeVar("_Value")


class KeptDecoder:
    """Wraps a decoder whose session closing might stop the robot.

    Attributes:
        trouble: Why the decoder would have ended the session; None again with the next good frame.
    """

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self.trouble: Refused | None = None

    @property
    def ready(self) -> bool:
        """Whether the handshake is done."""
        return self._guarded(lambda: self._decoder.ready, default=False)

    @property
    def notes(self) -> Sequence[str]:
        """What the operator should know of this session."""
        return self._guarded(lambda: self._decoder.notes, default=())

    @property
    def gaps(self) -> int | None:
        """How many frames are missing."""
        return self._guarded(lambda: self._decoder.gaps, default=None)

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; a refusal or a mistake of the plugin becomes a counted reject."""
        events: list[Event] = []
        mistake: list[Event] = [Reject(data, "plugin", "the plugin's decoder failed on these bytes")]
        for event in self._guarded(lambda: self._decoder.feed(data), default=mistake):
            if isinstance(event, Refused):
                self.trouble = event
                events.append(Reject(b"", "refused", event.reason))
            else:
                if isinstance(event, Frame):
                    self.trouble = None
                events.append(event)
        return events

    def end(self) -> list[Reject]:
        """Return what is left in the buffer."""
        return self._guarded(self._decoder.end, default=[])

    def outgoing(self) -> bytes:
        """Return the bytes owed to the controller now."""
        return self._guarded(self._decoder.outgoing, default=b"")

    def tick(self) -> bytes:
        """Return the next request or a retry; a refusal is kept as trouble."""
        nothing: bytes | Refused = b""
        asked = self._guarded(self._decoder.tick, default=nothing)
        if isinstance(asked, Refused):
            self.trouble = asked
            return b""
        return asked

    def goodbye(self) -> bytes:
        """Return the bytes owed before a wanted close."""
        return self._guarded(self._decoder.goodbye, default=b"")

    def _guarded(self, call: Callable[[], _Value], default: _Value) -> _Value:
        try:
            return call()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a plugin does, the session stays
            self.trouble = Refused(f"the plugin failed: {error!r}", "refused")
            return default
