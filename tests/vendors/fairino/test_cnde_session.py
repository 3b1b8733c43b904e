from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import anyio
import pytest

from gateway.api.decoder import Event, Frame, RefusedKind
from gateway.api.model import Link as LinkData
from gateway.api.model import LinkState
from gateway.core.bus import Bus
from gateway.core.events import EventRing
from gateway.core.link import Link
from gateway.core.session import Session
from gateway.core.settings import RobotSettings
from gateway.core.transport import Connection
from gateway.errors import LinkError, LinkStale
from tests.core.fakes import FakeConnection, FakeConnector, LoopClock, run_jumping
from tests.vendors.fairino.cnde_kit import virtual
from vendors.fairino import VENDOR
from vendors.fairino.cnde import CndeOptions, make_decoders
from vendors.fairino.cnde_protocol import CNDE
from vendors.fairino.cnde_states import ALL_STATES
from vendors.fairino.cnde_wire import CONFIGURE, START, STOP, configuration, frame
from vendors.fairino.simulator.cnde import CndeBehaviour, CndeSession

UDP = CndeOptions(transport="udp", states=("program_state", "actual_joint_pos"))


class Log:
    """A sink that keeps the times of frames."""

    def __init__(self) -> None:
        self.frames_s: list[float] = []

    def received(self, n_bytes: int, events: Sequence[Event], at_s: float, decode_s: float) -> None:
        """Keep the times."""
        assert min(n_bytes, decode_s) >= 0
        self.frames_s += [at_s for event in events if isinstance(event, Frame)]

    def silent(self, reason: str, kind: RefusedKind | None) -> None:
        """Never kept."""
        raise AssertionError((reason, kind))


class Controller:
    """A virtual session on a fake connection; what is sent may be lost."""

    def __init__(self, lose: Callable[[bytes], bool] = lambda _: False, behaviour: CndeBehaviour | None = None) -> None:
        self.session: CndeSession = virtual(behaviour)
        self.lose = lose
        self.until_s = float("inf")
        self.connection = FakeConnection(self._answer)
        self.connection.datagrams = True

    def _answer(self, data: bytes) -> list[bytes]:
        return [] if self.lose(data) else self.session.received(data, anyio.current_time())

    async def push(self) -> None:
        """Push data frames at the period that was asked for."""
        while True:
            await anyio.sleep(self.session.period_s or 0.001)
            if anyio.current_time() < self.until_s:
                for data in self.session.due(anyio.current_time()):
                    self.connection.push(data)


def settings(options: CndeOptions) -> RobotSettings:
    return RobotSettings(
        name="r1",
        host="192.0.2.1",
        port=20006,
        vendor=VENDOR,
        protocol=CNDE,
        rate_hz=None,
        stale_s=1.0,
        options=options,
    )


def talk(controller: Controller, options: CndeOptions, *, for_s: float) -> tuple[list[float], LinkError | None]:
    """Run one session; the times of its frames since it began, and why it ended if it did."""
    log = Log()
    ended: list[LinkError] = []
    begun_s: list[float] = []

    async def main() -> None:
        begun_s.append(anyio.current_time())
        with anyio.move_on_after(for_s):
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(controller.push)
                session = Session(
                    controller.connection,
                    make_decoders(options, 0)(),
                    log,
                    period_s=None,
                    stale_s=1.0,
                    on_stale="close",
                    clock=LoopClock(),
                    tick_s=CNDE.tick_s,
                    first_s=CNDE.handshake_s,
                )
                try:
                    await session.run()
                except LinkError as error:
                    ended.append(error)
                    tasks.cancel_scope.cancel()

    run_jumping(main)
    return [at_s - begun_s[0] for at_s in log.frames_s], ended[0] if ended else None


def test_data_comes_within_half_a_second_and_at_the_period() -> None:
    controller = Controller()
    times_s, error = talk(controller, UDP, for_s=2.0)
    assert error is None
    assert times_s[0] < 0.5
    assert len(times_s) == pytest.approx((2.0 - times_s[0]) / 0.008, abs=3)
    assert controller.connection.sent[-1][3] == STOP


@pytest.mark.parametrize("kind", [STOP, CONFIGURE, START])
def test_a_lost_datagram_costs_a_second_at_most(kind: int) -> None:
    lost = iter(range(1))
    controller = Controller(lambda data: data[3] == kind and next(lost, None) is not None)
    times_s, error = talk(controller, UDP, for_s=3.0)
    assert error is None
    assert times_s[0] < 1.2
    assert [data[3] for data in controller.connection.sent].count(kind) >= 2


def test_a_lost_answer_is_asked_for_again() -> None:
    controller = Controller()
    answers = controller.session.received
    lost = iter(range(1))

    def deaf_once(data: bytes, now_s: float) -> list[bytes]:
        told = answers(data, now_s)
        return [] if data[3] == CONFIGURE and next(lost, None) is not None else told

    controller.session.received = deaf_once  # type: ignore[method-assign] # a fault
    times_s, error = talk(controller, UDP, for_s=3.0)
    assert error is None
    assert times_s[0] < 1.2


def test_a_controller_that_says_nothing_is_given_up_after_the_time_of_the_handshake() -> None:
    controller = Controller(lambda _: True)
    times_s, error = talk(controller, UDP, for_s=60.0)
    assert isinstance(error, LinkStale)
    assert (times_s, error.reason) == ([], "connected, but not one byte came within 10 s")


def test_half_a_frame_and_then_silence_ends_the_session() -> None:
    controller = Controller()
    controller.connection.datagrams = False
    controller.until_s = 1001.0  # the loop begins at 1000

    async def half() -> None:
        await anyio.sleep(1.0)
        controller.connection.push(controller.session.due(0.0)[0][:20])

    push = controller.push

    async def push_and_break() -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(push)
            tasks.start_soon(half)

    controller.push = push_and_break  # type: ignore[method-assign] # a fault
    times_s, error = talk(controller, replace_transport(UDP), for_s=60.0)
    assert times_s
    assert isinstance(error, LinkStale)
    assert error.reason == "no good frame for 1 s"


def replace_transport(options: CndeOptions) -> CndeOptions:
    return CndeOptions(transport="tcp", states=options.states)


def test_a_link_narrows_once_and_configures_every_session_anew() -> None:
    known = set(ALL_STATES) - {"welding_voltage"}
    controllers = [Controller(behaviour=CndeBehaviour(known=known)) for _ in range(2)]
    connections: list[Connection | Exception] = [controller.connection for controller in controllers]
    bus = Bus(EventRing(10))
    states: list[LinkState] = []

    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            link = Link(settings(CndeOptions()), FakeConnector(*connections), bus, LoopClock())
            tasks.start_soon(link.run)
            for controller in controllers:
                tasks.start_soon(controller.push)
            await anyio.sleep(6)
            controllers[0].connection.end()
            await anyio.sleep(3)
            topic = bus.topics["r1/link"]
            assert topic.latest is not None
            data = topic.latest.sample(topic).data
            assert isinstance(data, LinkData)
            states.append(data.state)
            assert data.notes == ['the controller refuses welding_voltage; it says "NOT_FOUND"']
            assert data.layout == "136 states, 2217 bytes"
            tasks.cancel_scope.cancel()

    run_jumping(main)
    assert states == [LinkState.ONLINE]
    asked = [[data[3] for data in controller.connection.sent].count(CONFIGURE) for controller in controllers]
    assert 1 < asked[0] <= 12
    assert asked[1] == 1


def test_a_link_shows_the_layout_of_a_configuration_that_changed_inside_the_session() -> None:
    controller = Controller()
    bus = Bus(EventRing(10))
    shown: list[str | None] = []

    def layout() -> str | None:
        topic = bus.topics["r1/link"]
        assert topic.latest is not None
        data = topic.latest.sample(topic).data
        assert isinstance(data, LinkData)
        return data.layout

    async def main() -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(Link(settings(UDP), FakeConnector(controller.connection), bus, LoopClock()).run)
            tasks.start_soon(controller.push)
            await anyio.sleep(2)
            shown.append(layout())
            session = controller.session
            session.received(frame(STOP), 0.0)
            session._behaviour = CndeBehaviour(types={"program_state": "INT32"})
            session.received(configuration(UDP.states, 8), 0.0)
            session.received(frame(START), 0.0)
            await anyio.sleep(3)
            shown.append(layout())
            tasks.cancel_scope.cancel()

    run_jumping(main)
    assert shown == ["2 states, 57 bytes", "2 states, 60 bytes"]


def test_the_port_follows_the_transport() -> None:
    assert (CNDE.port_of(UDP), CNDE.port_of(CndeOptions())) == (20006, 20005)
    assert replace(CNDE, udp_port=None).transport(UDP) == "tcp"
