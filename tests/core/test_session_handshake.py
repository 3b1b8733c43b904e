from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import anyio
import pytest

from gateway.api.decoder import Event, Frame, Refused, RefusedKind, Reject
from gateway.api.framing import FramedDecoder
from gateway.core.session import Session
from gateway.errors import LinkError, LinkStale
from tests.core import toy
from tests.core.fakes import FakeConnection, LoopClock, run_jumping


class Shaking(FramedDecoder):
    """Says hello, repeats it at every tick, and owes two answers to whatever comes."""

    def __init__(self) -> None:
        super().__init__(toy.FRAMING)
        self.ticks_s: list[float] = []
        self._owed = b"hello"

    def feed(self, data: bytes) -> list[Event]:
        self._owed = b"thanks"
        return super().feed(data)

    def outgoing(self) -> bytes:
        owed, self._owed = self._owed, b""
        return owed

    def tick(self) -> bytes | Refused:
        self.ticks_s.append(anyio.current_time())
        return b"hello?" if len(self.ticks_s) % 2 == 0 else b""

    def goodbye(self) -> bytes:
        return b"bye"


class Log:
    """A sink that keeps the events."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def received(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:
        assert min(n_bytes, at_s, decode_s) >= 0
        self.events += events

    def silent(self, reason: str, kind: RefusedKind | None) -> None:
        raise AssertionError((reason, kind))


def run(
    answer: Callable[[bytes], Iterable[bytes]], first_s: float | None = None, *, datagrams: bool = False
) -> tuple[LinkError, Shaking, FakeConnection, Log, float]:
    """Run a session of a decoder with a handshake until it is lost."""
    decoder, log, connection = Shaking(), Log(), FakeConnection(answer)
    connection.datagrams = datagrams
    ended: list[tuple[LinkError, float]] = []

    async def main() -> None:
        start_s = anyio.current_time()
        session = Session(
            connection,
            decoder,
            log,
            period_s=None,
            stale_s=1.0,
            on_stale="close",
            clock=LoopClock(),
            tick_s=0.1,
            first_s=first_s,
        )
        with pytest.raises(LinkError) as caught:
            await session.run()
        ended.append((caught.value, anyio.current_time() - start_s))

    run_jumping(main)
    return ended[0][0], decoder, connection, log, ended[0][1]


def test_ticks_come_at_their_period_also_while_bytes_come() -> None:
    left = iter(range(20))
    _, decoder, _, _, _ = run(lambda data: (toy.frame(),) * 5 if data == b"hello?" and next(left, None) else ())
    gaps = [after - before for before, after in zip(decoder.ticks_s, decoder.ticks_s[1:], strict=False)]
    assert gaps[:10] == pytest.approx([0.1] * 10, abs=0.005)


def test_each_thing_that_is_owed_is_a_send_of_its_own() -> None:
    _, _, connection, _, _ = run(lambda data: (toy.frame(),) if data == b"hello" else ())
    assert set(connection.sent) == {b"hello", b"hello?", b"thanks", b"bye"}
    assert connection.sent[0] == b"hello"
    assert connection.sent[-1] == b"bye"


def test_a_handshake_may_take_longer_than_silence_later() -> None:
    error, _, _, _, took_s = run(lambda _: (), 10.0)
    assert isinstance(error, LinkStale)
    assert error.reason == "connected, but not one byte came within 10 s"
    assert took_s == pytest.approx(10, abs=0.03)
    left = iter(range(1))
    error, _, _, _, took_s = run(lambda _: (toy.frame(),) if next(left, None) is not None else (), 10.0)
    assert error.reason == "no good frame for 1 s"
    assert took_s == pytest.approx(1, abs=0.03)


def test_the_end_of_a_datagram_ends_its_frames() -> None:
    half = toy.frame()[:9]
    _, _, _, log, _ = run(lambda data: (half, toy.frame()) if data == b"hello" else (), datagrams=True)
    assert [type(event) for event in log.events[:2]] == [Reject, Frame]
    _, _, _, log, _ = run(lambda data: (half, toy.frame()[9:]) if data == b"hello" else ())
    assert [type(event) for event in log.events[:1]] == [Frame]
