"""A link that is called by its controller: real sockets on loopback, virtual time."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import cast

import anyio
from anyio.abc import SocketStream

from gateway.api.model import Joints, Link, LinkStats, Sample
from gateway.core.backoff import no_waiting
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.core.link import Link as RobotLink
from gateway.core.tcp_server import CALL_TIMEOUT_S, TcpServer
from tests.core import toy_text
from tests.core.fakes import LoopClock, run_jumping

CONTROLLER = "127.0.0.2"
STRANGER = "127.0.0.9"
VALUES: dict[str, object] = {"pos": [90.0], "vel": [1.0], "mode": "MANUAL", "stop": False}


class Cell:
    """One robot whose controller calls, and what its bus says."""

    def __init__(self) -> None:
        self.bus = Bus(EventRing(boot="b"))
        self.server = TcpServer("127.0.0.1", 0, CONTROLLER)
        self.link_task = RobotLink(toy_text.settings(), self.server, self.bus, LoopClock(), no_waiting)

    def sample(self, group: str) -> Sample:
        topic = self.bus.topics[f"r1/{group}"]
        assert topic.latest is not None
        return topic.latest.sample(topic)

    @property
    def link(self) -> Link:
        return cast("Link", self.sample("link").data)

    @property
    def stats(self) -> LinkStats:
        return cast("LinkStats", self.sample("link_stats").data)

    @property
    def kinds(self) -> list[str]:
        return [event.kind.value for event in self.bus.events.since(None, 100)[0]]

    def call(self, host: str = CONTROLLER) -> socket.socket:
        """Call the gateway."""
        one = socket.create_connection(("127.0.0.1", self.server.port), timeout=5, source_address=(host, 0))
        one.settimeout(0)
        return one

    @asynccontextmanager
    async def calling(self, values: Mapping[str, object]) -> AsyncIterator[list[bytes]]:
        """A controller that has called and answers for as long as the context lasts; yields what it was asked."""
        stream = await SocketStream.from_socket(self.call())
        asked: list[bytes] = []
        async with stream, anyio.create_task_group() as tasks:
            tasks.start_soon(self._answer, stream, values, asked)
            yield asked
            tasks.cancel_scope.cancel()

    async def _answer(self, stream: SocketStream, values: Mapping[str, object], asked: list[bytes]) -> None:
        answer = toy_text.answering(values)
        while True:
            try:
                question = await stream.receive()
            except anyio.EndOfStream:
                return
            asked.append(question)
            for piece in answer(question):
                await stream.send(piece)


def in_cell(look: Callable[[Cell], Awaitable[None]]) -> Cell:
    """Run a cell while a test looks at it."""
    cells: list[Cell] = []

    async def main() -> None:
        cells.append(cell := Cell())
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(cell.link_task.run)
            await anyio.sleep(0.1)
            await look(cell)
            tasks.cancel_scope.cancel()

    run_jumping(main)
    return cells[0]


def test_the_controller_calls_is_asked_goes_and_calls_again() -> None:
    async def look(cell: Cell) -> None:
        assert cell.link.state == "CONNECTING"
        async with cell.calling(VALUES) as asked:
            await anyio.sleep(5)
            assert cell.link.state == "ONLINE"
            assert cell.link.peer.startswith("127.0.0.2 (calls 127.0.0.1:")
            assert set(cell.link.parts_hz) == set(VALUES)
            assert cast("Joints", cell.sample("joints").data).position is not None
            assert set(asked) == {f"{name}\n".encode() for name in VALUES}
            epoch = cell.sample("joints").epoch
        await anyio.sleep(0.5)
        assert cell.link.state == "CONNECTING"
        assert cell.link.last_error == "the controller closed the connection"
        assert (cell.sample("joints").q, cell.sample("joints").data) == ("DISCONNECTED", Joints())
        await anyio.sleep(60)
        assert "no call from 127.0.0.2" in (cell.link.last_error or "")
        async with cell.calling({"pos": [45.0]}):
            await anyio.sleep(1)
            assert cell.link.state == "ONLINE"
            joints = cell.sample("joints")
            assert joints.epoch != epoch
            assert cast("Joints", joints.data).velocity is None
            assert cell.stats.sessions == 2
        await anyio.sleep(0.5)
        assert cell.kinds == ["link.online", "link.lost", "link.online", "link.lost"]

    in_cell(look)


def test_a_stranger_is_refused_and_seen_in_the_notes_and_counters_while_the_controller_is_waited_for() -> None:
    async def look(cell: Cell) -> None:
        with cell.call(STRANGER) as one:
            await anyio.sleep(0.1)
            assert one.recv(10) == b""
        await anyio.sleep(1.5)
        assert cell.stats.rejects == {"foreign_peer": 1}
        await anyio.sleep(CALL_TIMEOUT_S)
        assert cell.link.state == "CONNECTING"
        assert cell.link.notes[0].startswith("calls from 127.0.0.9 were refused: only 127.0.0.2 may call (once)")
        assert cell.kinds == []

    in_cell(look)


def test_a_stranger_that_calls_between_two_sessions_stays_in_the_notes_of_the_next_one() -> None:
    async def look(cell: Cell) -> None:
        with cell.call(STRANGER), cell.call(STRANGER):
            await anyio.sleep(0.1)
        async with cell.calling(VALUES):
            await anyio.sleep(2)
            assert cell.link.state == "ONLINE"
            assert cell.link.notes == ["calls from 127.0.0.9 were refused: only 127.0.0.2 may call (2 times)"]
            assert cell.stats.rejects == {"foreign_peer": 2}
            assert cell.stats.frames > 10

    in_cell(look)


def test_a_stranger_that_calls_during_a_session_is_refused_and_counted_at_once_and_disturbs_nothing() -> None:
    async def look(cell: Cell) -> None:
        async with cell.calling(VALUES):
            await anyio.sleep(1)
            with cell.call(STRANGER) as stranger:
                await anyio.sleep(0.1)
                assert stranger.recv(10) == b""
            await anyio.sleep(2)
            assert cell.stats.rejects == {"foreign_peer": 1}
            assert cell.link.notes == ["calls from 127.0.0.9 were refused: only 127.0.0.2 may call (once)"]
            assert cell.link.state == "ONLINE"
            await anyio.sleep(5)
        await anyio.sleep(2)
        assert cell.kinds == ["link.online", "link.lost"]

    in_cell(look)


def test_a_controller_that_was_started_anew_is_taken_at_once_and_the_silent_session_ends() -> None:
    async def look(cell: Cell) -> None:
        with cell.call() as dead:
            await anyio.sleep(1.1)
            assert cell.link.state == "HANDSHAKING"
            async with cell.calling(VALUES):
                await anyio.sleep(0.1)
                assert cell.link.last_error == "the controller has called again"
                await anyio.sleep(0.4)
                assert cell.link.state == "ONLINE"
                assert dead.recv(1000).endswith(b"bye\n")
        await anyio.sleep(0.1)

    in_cell(look)


def test_a_second_client_of_the_controller_does_not_disturb_the_session_that_works() -> None:
    async def look(cell: Cell) -> None:
        async with cell.calling(VALUES):
            await anyio.sleep(1)
            with cell.call() as second:
                await anyio.sleep(10)
                assert cell.link.state == "ONLINE"
                assert cell.kinds == ["link.online"]
                with contextlib.suppress(BlockingIOError):  # it is neither asked nor hung up on
                    assert second.recv(10) is None
        await anyio.sleep(0.1)

    in_cell(look)


def test_a_controller_that_speaks_at_once_and_goes_has_its_values_published() -> None:
    async def look(cell: Cell) -> None:
        with cell.call() as one:
            one.send(b"pos=[90]\nwhat=1\npos=[18")
        await anyio.sleep(1.5)
        assert cell.stats.frames == 1
        assert cell.stats.rejects == {"unknown": 1, "truncated": 1}
        assert cell.kinds == ["link.online", "link.lost"]

    in_cell(look)


def test_nobody_listens_any_more_when_the_link_has_ended() -> None:
    async def nothing(_: Cell) -> None:
        pass

    async def in_session(cell: Cell) -> None:
        cell.call().close()
        await anyio.sleep(0.1)

    for look in (nothing, in_session):
        cell = in_cell(look)
        assert cell.server.port != 0
        with socket.socket() as one:
            assert one.connect_ex(("127.0.0.1", cell.server.port)) != 0
