"""Finds out what a controller speaks: asks one protocol after the other, with one connection at a time.

It sends no more than a session would, and leaves out what its protocol calls a hazard unless that is allowed.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import anyio
import msgspec

from gateway.api.decoder import Decoder, Event, Frame, RefusedKind, Skipped
from gateway.api.vendor import Protocol, Transport, Vendor
from gateway.core.allowed import AllowedDecoder
from gateway.core.clock import SystemClock
from gateway.core.session import Session
from gateway.core.transport import Connection, Connector
from gateway.errors import LinkClosed, LinkError

Connect = Callable[[Transport, str, int], Connector]


class Verdict(Enum):
    """What came of asking."""

    SPEAKS = "speaks it"
    SILENT = "is open, but does not speak it"
    REFUSED = "is closed"
    UNREACHABLE = "cannot be reached"
    HAZARD = "is not asked"


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """One way in which a controller may be asked.

    Args:
        vendor: The plugin.
        protocol: One of its protocols.
        transport: What it is asked over.
        options: The options that a robot needs which is reached so.
        port: The vendor's port.
    """

    vendor: Vendor
    protocol: Protocol
    transport: Transport
    options: msgspec.Struct
    port: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What a question has shown.

    Attributes:
        reason: In words for the operator.
    """

    question: Question
    verdict: Verdict
    reason: str


def questions(vendors: Iterable[Vendor]) -> Iterator[Question]:
    """Every way to ask, the vendors' own order of protocols, TCP before UDP; without a port there is nothing to ask."""
    for vendor in vendors:
        for protocol in vendor.protocols:
            ways = [protocol.options()]
            if protocol.udp_port is not None and protocol.transport(ways[0]) == "tcp":
                ways.append(msgspec.structs.replace(ways[0], transport="udp"))
            for options in ways:
                port, transport = protocol.port_of(options), protocol.transport(options)
                if port is not None:
                    yield Question(vendor=vendor, protocol=protocol, transport=transport, options=options, port=port)


async def probe(
    vendors: Sequence[Vendor],
    host: str,
    connect: Connect,
    *,
    timeout_s: float,
    allow_hazards: bool = False,
    about_to_ask: Callable[[Question], None] = lambda _: None,
) -> AsyncIterator[Finding]:
    """Ask a controller what it speaks; a vendor that has been found is asked no further.

    Args:
        vendors: Whose protocols to ask for.
        host: Address of the controller.
        connect: Makes the connector of a transport, host and port.
        timeout_s: How long one answer may take.
        allow_hazards: Whether protocols are asked whose mere connection may do harm.
        about_to_ask: Called before each connection.
    """
    found: set[str] = set()
    for question in questions(vendors):
        if question.vendor.name in found:
            continue
        if question.protocol.hazard and not allow_hazards:
            yield Finding(question=question, verdict=Verdict.HAZARD, reason=question.protocol.hazard)
            continue
        about_to_ask(question)
        finding = await _ask(question, connect(question.transport, host, question.port), timeout_s)
        if finding.verdict is Verdict.SPEAKS:
            found.add(question.vendor.name)
        yield finding


async def _ask(question: Question, connector: Connector, timeout_s: float) -> Finding:
    """Connect, ask, and close again."""
    protocol = question.protocol
    made = protocol.probe() if protocol.probe else protocol.decoder(question.options)
    decoder = AllowedDecoder(made, question.vendor.name, protocol.outgoing)
    heard = _Heard(any_frame=protocol.probe is not None)
    try:
        connection = await connector.connect()
        try:
            await _listen(connection, decoder, protocol, heard, timeout_s)
        finally:
            with anyio.CancelScope(shield=True):
                await connection.aclose()
    except LinkClosed as error:
        if not heard.answer:
            verdict = Verdict.REFUSED if error.refused else Verdict.UNREACHABLE
            hint = protocol.when_refused if error.refused else ""
            return Finding(question=question, verdict=verdict, reason=". ".join(filter(None, (error.reason, hint))))
    except LinkError as error:
        if not heard.answer:
            return Finding(question=question, verdict=Verdict.SILENT, reason=error.reason)
    told = "; ".join(decoder.notes) if protocol.probe else ""
    return Finding(question=question, verdict=Verdict.SPEAKS, reason=told or heard.answer)


async def _listen(
    connection: Connection, decoder: Decoder, protocol: Protocol, heard: _Heard, timeout_s: float
) -> None:
    session = Session(
        connection,
        decoder,
        heard,
        period_s=None if protocol.rate_hz is None else 1 / protocol.rate_hz,
        stale_s=timeout_s,
        on_stale="close",
        clock=SystemClock(),
        tick_s=protocol.tick_s,
    )
    with heard.scope:
        await session.run()


class _Heard:
    """Takes what the session receives, and ends it with the first answer.

    Args:
        any_frame: Whether a frame without state is an answer too.

    Attributes:
        scope: What the session runs in.
        answer: What came, in words; "" while nothing has come.
    """

    def __init__(self, *, any_frame: bool) -> None:
        self._kinds = (Frame, Skipped) if any_frame else (Frame,)
        self.scope = anyio.CancelScope()
        self.answer = ""

    def received(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:  # noqa: ARG002
        """Take what was received; see `gateway.core.session.Sink`."""
        for event in events:
            if isinstance(event, self._kinds) and not self.answer:
                shown = event.layout.name if isinstance(event, Frame) else event.reason
                self.answer = f"{len(event.raw)} bytes came: {shown}"
                self.scope.cancel()

    def silent(self, reason: str, kind: RefusedKind | None) -> None:
        """Nothing is kept: a silent session ends."""
