"""The discipline of protocols whose answers do not say what they answer."""

from __future__ import annotations

from typing import Generic, TypeVar

from gateway.api.decoder import Event, Frame, Refused, Reject
from gateway.api.framing import FramedDecoder

Question = TypeVar("Question")


class Turn(Generic[Question]):
    """One question is outstanding, never two, and nothing is awaited for ever.

    Attributes:
        question: The outstanding one; None: nothing was asked.
        fed: Set with every received byte: a tick behind bytes is no time that passes.
    """

    __slots__ = ("_waited", "fed", "question")

    # How many periods unexplained bytes may wait for the rest of their frame before the stream counts as out of step.
    GRACE_TICKS = 5

    def __init__(self) -> None:
        self.question: Question | None = None
        self.fed = False
        self._waited = 0

    def ask(self, question: Question) -> None:
        """A question leaves."""
        self.question = question
        self._waited = 0

    def answered(self) -> None:
        """The answer has come."""
        self.question = None
        self._waited = 0

    def overstays(self, ticks: int = GRACE_TICKS) -> bool:
        """Count one more tick that waits; whether that makes so many without a byte received before them."""
        fed, self.fed = self.fed, False
        if fed:
            return False
        self._waited += 1
        return self._waited >= ticks


class Polled:
    """The discipline of a protocol that answers one request with one frame, and numbers neither.

    One request is outstanding, never two: a late answer would be taken for the next one, and every following sample
    would be one request old. A frame that nobody asked for, or bytes that stay unexplained before the next request,
    mean that the stream is out of step: only a new session helps.

    Args:
        decoder: Finds the frames.
        request: The bytes that ask for one frame.
    """

    GRACE_TICKS = Turn.GRACE_TICKS
    notes = ()

    def __init__(self, decoder: FramedDecoder, request: bytes) -> None:
        self._decoder = decoder
        self._request = request
        self._turn = Turn[bytes]()

    @property
    def ready(self) -> bool:
        """Whether frames may come: such protocols need no handshake."""
        return self._decoder.ready

    @property
    def gaps(self) -> int | None:
        """What the frames themselves tell."""
        return self._decoder.gaps

    def asked(self, data: bytes) -> None:
        """Take a request of a recorded session, which this decoder did not make."""
        self._turn.ask(data)

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes; a frame without a request is rejected and ends the session."""
        events = self._decoder.feed(data)
        if len(events) == 1 and self._turn.question and type(events[0]) is Frame:
            self._turn.question = None
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
        if self._turn.question:
            return b""
        if self._decoder.pending:
            if not self._turn.overstays():
                return b""
            return Refused(f"{self._decoder.pending} bytes came that no request asked for", "out_of_step")
        self._turn.ask(self._request)
        return self._request

    def goodbye(self) -> bytes:
        """Nothing is owed before a close."""
        return b""

    def _in_step(self, events: list[Event]) -> list[Event]:
        self._turn.fed = True
        kept: list[Event] = []
        refused: list[Event] = []
        for event in events:
            if type(event) is not Frame:
                kept.append(event)
            elif self._turn.question:
                self._turn.answered()
                kept.append(event)
            else:
                kept.append(
                    Reject(event.raw, "unrequested", f"a frame of {len(event.raw)} bytes that nobody asked for")
                )
                refused = [Refused("a frame came that no request asked for", "out_of_step")]
        return kept + refused
