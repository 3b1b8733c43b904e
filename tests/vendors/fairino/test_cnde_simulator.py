from __future__ import annotations

import struct
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace

import anyio
import msgspec
import pytest

from gateway.api.model import Link as LinkData
from gateway.api.model import LinkState, LinkStats
from gateway.api.vendor import Transport, Vendor
from gateway.app import connector_of
from gateway.core.bus import Bus
from gateway.core.clock import SystemClock
from gateway.core.events import EventRing
from gateway.core.link import Link
from gateway.core.settings import RobotSettings
from gateway.sim.scenario import find_scenario
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import Port, Simulator, VirtualRobot
from tests.vendors.fairino.cnde_kit import virtual
from vendors.fairino.cnde import CndeOptions
from vendors.fairino.cnde_protocol import CNDE
from vendors.fairino.cnde_states import ALL_STATES, HEADER
from vendors.fairino.cnde_wire import FIRMWARE, MESSAGE, START, STOP, configuration, frame
from vendors.fairino.simulator.cnde import FILLERS, CndeBehaviour, CndeSession, known_states

VENDOR = Vendor(name="fairino", title="FAIRINO", protocols=(CNDE,))


def simulator(behaviour: CndeBehaviour) -> Simulator:
    def session(robot: VirtualRobot, _options: msgspec.Struct) -> CndeSession:
        return CndeSession(robot, behaviour)

    port = Port(protocol="cnde", port=20005, session=session, header=HEADER, fillers=FILLERS)
    return Simulator(ports=(port, replace(port, port=20006, transport="udp")))


@asynccontextmanager
async def served(behaviour: CndeBehaviour | None = None, chaos: str = "") -> AsyncIterator[VirtualController]:
    async with serve(simulator(behaviour or CndeBehaviour()), host="127.0.0.1", port=0, chaos=chaos) as (controller,):
        yield controller


def robot(port: int, transport: Transport, states: Sequence[str] = ()) -> RobotSettings:
    return RobotSettings(
        name="r1",
        host="127.0.0.1",
        port=port,
        vendor=VENDOR,
        protocol=CNDE,
        rate_hz=None,
        stale_s=1.0,
        options=CndeOptions(transport="udp" if transport == "udp" else "tcp", states=tuple(states)),
    )


async def eventually(condition: Callable[[], bool]) -> None:
    with anyio.fail_after(15):
        while not condition():  # noqa: ASYNC110 - it happens on the other end of a socket
            await anyio.sleep(0.01)


class Reading:
    """A running link and what it last said."""

    def __init__(self, settings: RobotSettings) -> None:
        self.bus = Bus(EventRing(100))
        self.link = Link(settings, connector_of(settings), self.bus, SystemClock())

    def data(self, group: str) -> object:
        """What a topic holds."""
        topic = self.bus.topics[f"r1/{group}"]
        assert topic.latest is not None
        return topic.latest.sample(topic).data

    @property
    def state(self) -> LinkData:
        """What the link says of itself."""
        data = self.data("link")
        assert isinstance(data, LinkData)
        return data

    async def lost(self) -> LinkData:
        """Wait until something went wrong."""
        await eventually(lambda: self.state.last_error is not None)
        return self.state

    async def until(self, state: LinkState) -> LinkData:
        """Wait until the link is in a state."""
        await eventually(lambda: self.state.state is state)
        return self.state


@asynccontextmanager
async def reading(settings: RobotSettings) -> AsyncIterator[Reading]:
    async with anyio.create_task_group() as tasks:
        found = Reading(settings)
        tasks.start_soon(found.link.run)
        yield found
        tasks.cancel_scope.cancel()


@asynccontextmanager
async def served_and_read(
    transport: Transport, behaviour: CndeBehaviour | None = None, chaos: str = ""
) -> AsyncIterator[tuple[VirtualController, Reading]]:
    async with AsyncExitStack() as stack:
        controller = await stack.enter_async_context(served(behaviour, chaos))
        settings = robot(controller.number_of("cnde", transport), transport)
        yield controller, await stack.enter_async_context(reading(settings))


def answers(session: CndeSession, *asked: bytes) -> list[bytes]:
    return [answer[HEADER:-2] for data in asked for answer in session.received(data, 0.0)]


def test_each_answer_is_a_message_of_its_own() -> None:
    asked = (frame(STOP), configuration(["program_state", "actual_joint_pos"], 8), frame(START))
    session = virtual()
    assert [session.received(data, 0.0) for data in asked] == [
        [frame(MESSAGE, b"\0STOP_OK")],
        [frame(MESSAGE, b"\0UINT8,DOUBLE_6")],
        [frame(MESSAGE, b"\0START_OK")],
    ]
    assert session.period_s == 0.008
    (data,) = session.due(0.0)
    assert data[HEADER:-2] == struct.pack("<B6d", 2, 10.0, -20.5, 30.25, -40.0, 50.0, 60.0)


def test_questions_may_be_cut_and_joined() -> None:
    stream = frame(STOP) + configuration(["alarm"], 20) + frame(START)
    session = virtual()
    found = [answer for at in range(len(stream)) for answer in session.received(stream[at : at + 1], 0.0)]
    assert len(found) == 3
    assert len(virtual().received(stream, 0.0)) == 3


def test_what_clients_may_not_do_is_refused() -> None:
    session = virtual()
    assert answers(session, frame(START)) == [b"\x03NOT_CONFIGURED"]
    assert answers(session, configuration(["alarm", "queue_quene"], 8)) == [b"\x03NOT_FOUND"]
    assert answers(session, configuration(["alarm"], 0)) == [b"\x03PERIOD_OUT_OF_RANGE"]
    assert answers(session, configuration(["alarm"], 8), frame(START), configuration(["alarm"], 8))[-1] == (
        b"\x03OUTPUT_IS_RUNNING"
    )
    assert answers(session, frame(STOP), configuration(["alarm"], 8)) == [b"\0STOP_OK", b"\0UINT8"]
    assert answers(session, frame(0, b"\x01std_DO_box"), frame(5, b"\x01\xff")) == [b"\x03NOT_SUPPORTED"] * 2
    assert answers(session, frame(FIRMWARE)) == [b"\0FR5,V3.9.7,virtual"]
    assert answers(session, frame(MESSAGE, b"\x01hello")) == []


def test_a_firmware_knows_the_states_that_its_frame_holds() -> None:
    assert len(known_states(2073)) == 132
    assert set(known_states(2074)) - set(known_states(2073)) == {"exaxis_coord_id"}
    assert set(known_states(2075)) == set(ALL_STATES)
    assert known_states(1236)[-1] == "servoJ_cmd_num"


@pytest.mark.parametrize("transport", ["tcp", "udp"])
async def test_over_real_sockets_every_frame_that_is_sent_arrives(transport: Transport) -> None:
    async with served() as controller, reading(robot(controller.number_of("cnde", transport), transport)) as found:
        link = await found.until(LinkState.ONLINE)
        assert link.notes == []
        assert link.layout is not None
        assert link.layout.endswith(" bytes")
        await anyio.sleep(1.5)
        stats = found.data("link_stats")
        assert isinstance(stats, LinkStats)
        assert stats.frames > 50
        assert stats.rejects == {}
        assert stats.gaps is None  # the counter never moved
        assert stats.clock_offset is not None
        frames = controller.robot.frames
    await anyio.sleep(0.05)
    assert controller.robot.frames <= frames + 3  # the last word was stop


async def test_a_counter_that_moves_counts_gaps() -> None:
    async with served_and_read("udp", CndeBehaviour(counts=True), chaos="tail=0.1") as (_, found):
        await found.until(LinkState.ONLINE)
        await anyio.sleep(1.5)
        stats = found.data("link_stats")
        assert isinstance(stats, LinkStats)
        assert stats.gaps
        assert set(stats.rejects) == {"truncated"}


@pytest.mark.parametrize("transport", ["tcp", "udp"])
async def test_a_narrowed_configuration_is_named_in_the_link(transport: Transport) -> None:
    known = set(ALL_STATES) - {"collision_state"}
    async with served_and_read(transport, CndeBehaviour(known=known)) as (_, found):
        link = await found.until(LinkState.ONLINE)
        assert link.notes == ['the controller refuses collision_state; it says "NOT_FOUND"']


async def test_a_closed_port_is_explained() -> None:
    async with served() as controller:
        tcp, udp = controller.number_of("cnde"), controller.number_of("cnde", "udp")
    for port, transport in ((tcp, "tcp"), (udp, "udp")):
        async with reading(robot(port, transport)) as found:  # type: ignore[arg-type] # a literal
            link = await found.lost()
            assert "refused" in str(link.last_error)
            assert "port 20005 came with firmware 3.9.5" in link.notes[0]


@pytest.mark.parametrize("chaos", ["split=0.3,junk=0.2", "coalesce=0.3,skip=0.3", "header=0.1", "cut=0.8"])
@pytest.mark.parametrize("transport", ["tcp", "udp"])
async def test_chaos_is_lived_through(transport: Transport, chaos: str) -> None:
    async with served_and_read(transport, chaos=chaos) as (controller, found):
        await found.until(LinkState.ONLINE)
        wanted = controller.robot.frames + 50
        await eventually(lambda: controller.robot.frames >= wanted)
        await found.until(LinkState.ONLINE)


async def test_the_robot_of_the_scenario_is_what_is_read() -> None:
    async with served() as controller, reading(robot(controller.number_of("cnde"), "tcp")) as found:
        await found.until(LinkState.ONLINE)
        joints = msgspec.to_builtins(found.data("joints"))
        assert len(joints["position"]) == 6
        assert joints["current"] is not None
    assert controller.robot.scenario is find_scenario("cell")
