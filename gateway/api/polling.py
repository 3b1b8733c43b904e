"""The discipline of protocols that answer one request with one frame."""

from __future__ import annotations

from gateway.api.decoder import Event, Frame, Refused, Reject
from gateway.api.framing import FramedDecoder


class Polled:
    """The discipline of a protocol that answers one request with one frame, and numbers neither.

    One request is outstanding, never two: a late answer would be taken for the next one, and every following sample
    would be one request old. A frame that nobody asked for, or bytes that stay unexplained before the next request,
    mean that the stream is out of step: only a new session helps.

    Args:
        decoder: Finds the frames.
        request: The bytes that ask for one frame.
    """

    # How many periods unexplained bytes may wait for the rest of their frame before the stream counts as out of step.
    GRACE_TICKS = 5
    notes = ()

    def __init__(self, decoder: FramedDecoder, request: bytes) -> None:
        self._decoder = decoder
        self._request = request
        self._outstanding = False
        self._waited = 0
        self._fed = False

    @property
    def ready(self) -> bool:
        """Whether frames may come: such protocols need no handshake."""
        return self._decoder.ready

    @property
    def gaps(self) -> int | None:
        """What the frames themselves tell."""
        return self._decoder.gaps

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; a frame without a request is rejected and ends the session."""
        events = self._decoder.feed(data)
        if len(events) == 1 and self._outstanding and type(events[0]) is Frame:
            self._outstanding = False
            return events
        return self._in_step(events)

    def end(self) -> list[Reject]:
        """Return what is left in the buffer."""
        return self._decoder.end()

    def outgoing(self) -> bytes:
        """Nothing is owed between requests."""
        return b""

    def tick(self) -> bytes | Refused:
        """Return the request, or b"" while one is outstanding or received bytes are unexplained."""
        if self._outstanding:
            return b""
        if self._decoder.pending:
            fed, self._fed = self._fed, False
            if fed:  # it is bytes that wake an overdue tick, not only time
                return b""
            self._waited += 1
            if self._waited < self.GRACE_TICKS:
                return b""
            return Refused(f"{self._decoder.pending} bytes came that no request asked for", "out_of_step")
        self._waited = 0
        self._outstanding = True
        return self._request

    def goodbye(self) -> bytes:
        """Nothing is owed before a close."""
        return b""

    def _in_step(self, events: list[Event]) -> list[Event]:
        self._fed = True
        kept: list[Event] = []
        refused: list[Event] = []
        for event in events:
            if type(event) is not Frame:
                kept.append(event)
            elif self._outstanding:
                self._outstanding = False
                kept.append(event)
            else:
                kept.append(
                    Reject(event.raw, "unrequested", f"a frame of {len(event.raw)} bytes that nobody asked for")
                )
                refused = [Refused("a frame came that no request asked for", "out_of_step")]
        return kept + refused
