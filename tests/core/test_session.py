from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Iterable, Sequence

import anyio
import anyio.abc
import anyio.lowlevel
import pytest

from gateway.api.decoder import Event, Frame, Refused, RefusedKind, Reject, Skipped
from gateway.api.framing import FramedDecoder
from gateway.api.vendor import OnStale
from gateway.core.clock import SystemClock
from gateway.core.session import Session
from gateway.core.transport import TcpClient
from gateway.errors import LinkClosed, LinkError, LinkRefused, LinkStale
from tests.core import toy
from tests.core.fakes import FakeConnection, LoopClock, run_jumping
from tests.garbage import uncollected


class Log:
    """A sink that keeps what it is told."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.silences: list[str] = []
        self.frames_s: list[float] = []

    def received(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:
        assert n_bytes >= 0
        assert decode_s >= 0
        self.events += events
        self.frames_s += [at_s for event in events if isinstance(event, Frame)]

    def silent(self, reason: str, kind: RefusedKind | None) -> None:
        self.silences.append(reason if kind is None else f"{kind}: {reason}")


def session(connection: FakeConnection, log: Log, *, pushed: bool = False, on_stale: OnStale = "close") -> Session:
    protocol = toy.PUSHED if pushed else toy.POLLED
    return Session(
        connection,
        protocol.decoder(protocol.options()),
        log,
        period_s=None if pushed else 0.1,
        stale_s=1.0,
        on_stale=on_stale,
        clock=LoopClock(),
    )


def lost(run: Callable[[Log], tuple[FakeConnection, Session]]) -> tuple[LinkError, Log, FakeConnection]:
    """Run a session until it is lost."""
    log = Log()
    ended: list[tuple[LinkError, FakeConnection]] = []

    async def main() -> None:
        connection, one = run(log)
        with pytest.raises(LinkError) as caught:
            await one.run()
        ended.append((caught.value, connection))

    run_jumping(main)
    return ended[0][0], log, ended[0][1]


def answering(
    answer: Callable[[bytes], Iterable[bytes]], delay_s: float = 0.001
) -> tuple[LinkError, Log, FakeConnection]:
    def run(log: Log) -> tuple[FakeConnection, Session]:
        connection = FakeConnection(answer, delay_s)
        return connection, session(connection, log)

    return lost(run)


def for_a_while(count: int, *then: bytes) -> Callable[[bytes], Iterable[bytes]]:
    """Answer so many requests, then with something else for ever."""
    left = iter(range(count))
    return lambda _: (toy.frame(),) if next(left, None) is not None else then


def test_requests_leave_at_the_period_exactly() -> None:
    _, log, connection = answering(for_a_while(100))
    assert set(connection.sent) == {b"ask"}
    assert len(log.frames_s) == 100
    assert log.frames_s[-1] - log.frames_s[0] == pytest.approx(9.9, abs=0.005)


def test_a_late_answer_delays_the_next_request_and_none_is_sent_meanwhile() -> None:
    _, log, connection = answering(for_a_while(10), delay_s=0.25)
    assert len(log.frames_s) == 10
    assert len(connection.sent) == 11
    gaps = [after - before for before, after in zip(log.frames_s, log.frames_s[1:], strict=False)]
    assert gaps == pytest.approx([0.25] * 9, abs=0.01)


def test_a_lost_answer_ends_a_polled_session_after_stale_s_without_a_second_request() -> None:
    error, log, connection = answering(for_a_while(3))
    assert isinstance(error, LinkStale)
    assert error.reason == "no good frame for 1 s"
    assert len(connection.sent) == len(log.frames_s) + 1


def test_a_session_that_never_got_a_byte_says_so() -> None:
    error, _, _ = answering(lambda _: ())
    assert error.reason == "connected, but not one byte came within 1 s"


def test_a_session_of_wrong_bytes_names_the_last_reject() -> None:
    error, _, _ = answering(lambda _: (b"HTTP/1.1 400 Bad Request\r\n\r\n",))
    assert error.reason == "connected, 28 bytes came, but no good frame; last reject: junk"


def test_half_a_frame_and_then_silence_says_what_the_header_promised() -> None:
    error, log, _ = answering(lambda _: (toy.frame()[:9],))
    assert "truncated (the header promises 20 bytes, 9 came)" in error.reason
    assert [event.reason for event in log.events if isinstance(event, Reject)] == ["truncated"]


def test_a_frame_that_nobody_asked_for_ends_the_session_as_out_of_step() -> None:
    error, log, _ = answering(lambda _: (toy.frame() + toy.frame(angle=9.0),))
    assert isinstance(error, LinkRefused)
    assert error.kind == "out_of_step"
    assert [type(event) for event in log.events[:2]] == [Frame, Reject]


def test_skipped_frames_neither_answer_a_request_nor_keep_a_session_alive() -> None:
    error, log, connection = answering(lambda _: (toy.OTHER, toy.OTHER))
    assert isinstance(error, LinkStale)
    assert [type(event) for event in log.events] == [Skipped, Skipped]
    assert len(connection.sent) == 1


def test_the_end_of_the_stream_ends_the_session() -> None:
    def run(log: Log) -> tuple[FakeConnection, Session]:
        connection = FakeConnection()
        connection.push(toy.frame()[:5])
        connection.end()
        return connection, session(connection, log, pushed=True)

    error, log, _ = lost(run)
    assert isinstance(error, LinkClosed)
    assert [event.reason for event in log.events if isinstance(event, Reject)] == ["truncated"]


def test_a_kept_session_goes_stale_and_comes_back_without_a_new_connection() -> None:
    log = Log()

    async def main() -> None:
        connection = FakeConnection()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(session(connection, log, pushed=True, on_stale="keep").run)
            connection.push(toy.frame())
            await anyio.sleep(5)
            assert log.silences == ["no good frame for 1 s"]
            connection.push(b"junk" + toy.frame())
            await anyio.sleep(0.5)
            assert len(log.frames_s) == 2
            await anyio.sleep(5)
            assert len(log.silences) == 2
            assert not connection.closed
            assert connection.sent == []
            tasks.cancel_scope.cancel()

    run_jumping(main)


def test_good_frames_keep_moving_the_deadline_on() -> None:
    log = Log()

    async def main() -> None:
        connection = FakeConnection()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(session(connection, log, pushed=True).run)
            for _ in range(50):
                connection.push(toy.frame())
                await anyio.sleep(0.9)
            tasks.cancel_scope.cancel()

    run_jumping(main)
    assert len(log.frames_s) == 50


def test_frames_that_no_layout_explains_are_incompatible_and_named_with_size_and_header() -> None:
    error, _, _ = answering(lambda _: (b"$\x0c\x00\x03" + bytes(12),))
    assert isinstance(error, LinkRefused)
    assert error.kind == "incompatible"
    assert "state of 16 bytes (header 24 0c 00 03), known are 20 or more" in error.reason


def test_a_kept_session_of_such_frames_stays_open() -> None:
    log = Log()

    async def main() -> None:
        connection = FakeConnection()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(session(connection, log, pushed=True, on_stale="keep").run)
            connection.push(b"$\x0c\x00\x03" + bytes(12))
            await anyio.sleep(3)
            assert not connection.closed
            tasks.cancel_scope.cancel()

    run_jumping(main)
    (silence,) = log.silences
    assert silence.startswith("incompatible: connected, 16 bytes came, but no good frame; last reject: size")


def test_what_came_while_the_loop_stood_still_is_read_before_silence_is_told() -> None:
    log = Log()

    async def main() -> None:
        connection = FakeConnection()
        connection.push(toy.frame())
        one = session(connection, log, pushed=True)
        async with anyio.create_task_group() as tasks:

            async def read() -> None:
                with pytest.raises(LinkStale):
                    await one.run()

            tasks.start_soon(read)
            await anyio.sleep(1.005)  # the deadline has passed, and only now does the loop see what has come
            for _ in range(3):
                connection.push(toy.frame())

    run_jumping(main)
    assert sum(isinstance(event, Frame) for event in log.events) == 4
    assert log.frames_s[-1] - log.frames_s[0] == pytest.approx(1.005, abs=0.02)


def quiet(delay_s: float, surplus_s: float | None = None) -> tuple[list[float], Log, LinkError | None]:
    """Ask for a second, with quiet after an answer that takes too long; one answer may come again, so much later."""
    log = Log()
    asked_s: list[float] = []
    ended: list[LinkError] = []

    async def main() -> None:
        def answer(_: bytes) -> tuple[bytes, ...]:
            asked_s.append(anyio.current_time())
            asyncio.get_running_loop().call_later(delay_s, connection.push, toy.frame())
            return ()

        connection = FakeConnection(answer, 0.0)
        protocol = toy.POLLED
        one = Session(
            connection,
            protocol.decoder(protocol.options()),
            log,
            period_s=0.1,
            stale_s=1.0,
            on_stale="close",
            clock=LoopClock(),
            quiet_s=0.05,
        )

        async def run() -> None:
            try:
                await one.run()
            except LinkError as error:
                ended.append(error)

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(run)
            if surplus_s is not None:
                await anyio.sleep(delay_s + surplus_s)
                connection.push(toy.frame())
            await anyio.sleep(1.0)
            tasks.cancel_scope.cancel()

    run_jumping(main)
    return asked_s, log, ended[0] if ended else None


@pytest.mark.parametrize(("delay_s", "period_s"), [(0.01, 0.1), (0.09, 0.1), (0.15, 0.2), (0.19, 0.24)])
def test_after_an_answer_that_takes_too_long_half_a_period_stays_quiet(delay_s: float, period_s: float) -> None:
    asked_s, log, error = quiet(delay_s)
    assert error is None
    gaps = [after - before for before, after in itertools.pairwise(asked_s)]
    assert all(period_s - 0.005 <= gap <= period_s + 0.05 for gap in gaps)
    if delay_s > 0.1:
        frames_s = zip(asked_s[1:], log.frames_s, strict=False)
        assert all(asked - answered >= 0.05 - 0.002 for asked, answered in frames_s)


def test_an_answer_too_many_that_comes_in_the_quiet_time_ends_the_session() -> None:
    asked_s, log, error = quiet(0.15, surplus_s=0.02)
    assert isinstance(error, LinkRefused)
    assert error.kind == "out_of_step"
    assert (len(asked_s), len(log.frames_s)) == (1, 1)


class HangsUp(FakeConnection):
    """The controller hangs up while something is being sent that cannot be given up."""

    async def receive(self) -> bytes:
        await anyio.lowlevel.checkpoint()
        raise LinkRefused("what was read", "incompatible")

    async def send(self, data: bytes) -> None:
        self.sent.append(data)
        with anyio.CancelScope(shield=True):
            await anyio.sleep(0.01)
        raise LinkClosed("what was sent")


def test_of_two_reasons_that_come_at_once_the_one_that_was_read_is_told() -> None:
    error, _, _ = lost(lambda log: ((connection := HangsUp()), session(connection, log)))
    assert error.reason == "what was read"
    assert (error.__cause__, error.__context__) == (None, None)


class Refuses(FramedDecoder):
    """Has nothing more to ask."""

    def tick(self) -> bytes | Refused:
        return Refused("no more", "refused")


@pytest.mark.parametrize("by_reading", [True, False])
def test_a_session_that_is_lost_leaves_nothing_to_the_collector_of_garbage(*, by_reading: bool) -> None:
    async def serve(controller: anyio.abc.SocketStream) -> None:
        async with controller:
            await controller.send(b"junk")
            if not by_reading:
                with contextlib.suppress(anyio.BrokenResourceError, anyio.EndOfStream):
                    await controller.receive()

    async def lose(port: int) -> None:
        assert toy.PUSHED.framing is not None
        connection = await TcpClient("127.0.0.1", port).connect()
        decoder = (FramedDecoder if by_reading else Refuses)(toy.PUSHED.framing)
        clock = SystemClock()
        one = Session(
            connection, decoder, Log(), period_s=None, stale_s=5.0, on_stale="close", clock=clock, tick_s=0.01
        )
        with contextlib.suppress(LinkClosed, LinkRefused):
            await one.run()
        await connection.aclose()

    async def story() -> None:
        listener = await anyio.create_tcp_listener(local_host="127.0.0.1", local_port=0)
        port = listener.extra(anyio.abc.SocketAttribute.local_port)  # noqa: S610 - not that `extra`
        async with listener, anyio.create_task_group() as tasks:
            tasks.start_soon(listener.serve, serve)
            await lose(port)
            with uncollected() as found:
                for _ in range(5):
                    await lose(port)
            tasks.cancel_scope.cancel()
        # The controller's end is anyio's, and leaves circles of its own.
        assert not {"Session", "TcpStream", "LinkClosed", "LinkRefused", "FramedDecoder", "Refuses"} & found.keys()

    anyio.run(story, backend_options={"use_uvloop": True})
