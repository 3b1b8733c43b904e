"""The virtual FAIRINO controller: what each firmware offers, what it says, and how it can be made to say it badly."""

from __future__ import annotations

import asyncio
import xmlrpc.client
from collections.abc import Callable
from typing import Literal, cast, get_args

import pytest

from gateway.api.decoder import Event, Frame, Reject
from gateway.api.model import Joints, Motion, Quality, SafetyState, Status
from gateway.api.normaliser import Normaliser
from gateway.api.vendor import Protocol
from gateway.sim.scenario import SCENARIOS, find_scenario
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import VirtualRobot
from vendors.fairino.layouts import LONGEST, STATUS_433
from vendors.fairino.pushed import LEGACY, STATUS
from vendors.fairino.signals import SIGNALS
from vendors.fairino.simulator import SIMULATOR, FairinoOptions, Firmware, LegacySession, StatusSession
from vendors.fairino.simulator.rpc import RpcSession
from vendors.fairino.simulator.values import frame_values

HOST = "127.0.0.1"


def robot(scenario: str = "steady") -> VirtualRobot:
    return VirtualRobot(find_scenario(scenario))


def options(firmware: str, **others: object) -> FairinoOptions:
    return FairinoOptions(cast("Firmware", firmware), **others)  # type: ignore[arg-type] # of the struct's own types


def ports(controller: VirtualController) -> set[int]:
    """The vendor's numbers of the ports that a firmware offers."""
    return {port.port for port in SIMULATOR.ports if port.offered(controller.options)}


@pytest.mark.parametrize(
    ("firmware", "offered"),
    [
        ("3.7.6", {20004, 8083, 20003, 8080}),
        ("3.8.1", {20004, 8083, 20003, 8080}),
        ("3.8.3", {20004, 8083, 20003, 8080, 20006}),
        ("3.9.4", {20004, 8083, 20003, 8080, 20006}),
        ("3.9.6", {8083, 20003, 8080, 20005, 20006}),
        ("all", {20004, 8083, 20003, 8080, 20005, 20006}),
    ],
)
async def test_a_firmware_offers_its_ports_and_no_other(firmware: str, offered: set[int]) -> None:
    async with serve(SIMULATOR, host=HOST, port=0, options=options(firmware)) as (controller,):
        assert ports(controller) == offered
        assert len(controller.ports) == len(offered)


def test_port_20004_of_new_firmware_opens_when_asked_for() -> None:
    assert not options("3.9.6").offers_legacy
    assert options("3.9.6", legacy=True).offers_legacy


@pytest.mark.parametrize(
    ("firmware", "size"),
    [
        ("3.6", 584),
        ("3.7.1", 584),
        ("3.7.3", 609),
        ("3.7.5", 777),
        ("3.7.6", 888),
        ("3.7.7", 900),
        ("3.8.1", 902),
        ("3.8.2", 954),
        ("3.8.3", 960),
        ("3.8.5", 960),
        ("3.8.6", 1184),
        ("3.8.7", 1236),
        ("3.9.4", 1236),
        ("3.9.5", 2073),
        ("3.9.7", 2074),
        ("3.9.8", 2075),
        ("all", 1236),
    ],
)
def test_every_firmware_sends_frames_of_its_own_size(firmware: str, size: int) -> None:
    raw = LegacySession(robot(), options(firmware)).frame(1.0)
    assert len(raw) == size
    (event,) = LEGACY.reader().feed(raw)
    assert isinstance(event, Frame)
    assert event.layout.name == str(size)


def test_every_firmware_has_numbers() -> None:
    assert [name for name in get_args(Firmware) if not options(name).version] == []


def test_states_of_newer_firmware_are_unknown_to_older() -> None:
    assert "exaxis_coord_id" not in options("3.9.5").states
    assert "exaxis_coord_id" in options("3.9.6").states
    assert "program_run_state" not in options("3.9.7").states
    assert "program_run_state" in options("3.9.8").states


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_value_is_a_field_of_the_table(scenario: str) -> None:
    found = frame_values(robot(scenario).state(4.2))
    others = {"program_name", "run_up_time", "timestamp_us"}
    assert set(found) - others <= set(LONGEST.by_name)
    LONGEST.encode({name: value for name, value in found.items() if name not in others})


def test_what_is_decoded_is_what_was_meant() -> None:
    virtual = VirtualRobot(find_scenario("cell"), keep=300)
    session = LegacySession(virtual, options("3.9.8"))
    reader = LEGACY.reader()
    normaliser = Normaliser(SIGNALS, {"estop_polarity": None})
    for number in range(300):
        (event,) = reader.feed(session.frame(number * 0.25))
        assert isinstance(event, Frame)
        vendor, quality = normaliser.readers(event.layout)["vendor"].read(event)
        assert quality is Quality.GOOD
        assert isinstance(vendor, dict)
        plain = {name: word["raw"] if isinstance(word, dict) else word for name, word in vendor.items()}
        assert plain == virtual.sent[-1].values()


def told(scenario: str, at_s: float) -> tuple[Status, object]:
    (event,) = LEGACY.reader().feed(LegacySession(robot(scenario), options("3.9.8")).frame(at_s))
    assert isinstance(event, Frame)
    readers = Normaliser(SIGNALS, {"estop_polarity": None}).readers(event.layout)
    status, safety = (readers[group].read(event)[0] for group in ("status", "safety"))
    assert isinstance(status, Status)
    return status, getattr(safety, "state", None)


def test_scenarios_are_told_in_the_vendors_words() -> None:
    assert told("freedrive", 4.0)[0].motion is Motion.HAND_GUIDING
    status, safety = told("estop", 5.0)
    assert (status.e_stopped, safety) == (True, SafetyState.EMERGENCY_STOP)
    status, safety = told("collision", 6.5)
    assert safety is SafetyState.PROTECTIVE_STOP
    status, safety = told("fault", 6.5)
    assert [fault.code for fault in status.faults or []] == ["main_code", "driverError"]
    assert status.in_error is True


def test_both_ports_tell_one_motion() -> None:
    virtual = robot()
    (legacy,) = LEGACY.reader().feed(LegacySession(virtual, options("all")).frame(3.3))
    (status,) = STATUS.reader().feed(StatusSession(virtual, options("all")).frame(3.3))
    found = []
    for protocol, event in ((LEGACY, legacy), (STATUS, status)):
        assert isinstance(event, Frame)
        readers = Normaliser(protocol.signals, {"estop_polarity": None}).readers(event.layout)
        joints = readers["joints"].read(event)[0]
        assert isinstance(joints, Joints)
        found.append(joints)
    assert found[0].position == found[1].position
    assert found[0].effort == pytest.approx(found[1].effort)


def test_older_firmware_has_the_shorter_frame_on_port_8083() -> None:
    assert len(StatusSession(robot(), options("3.7.1")).frame(0.0)) == 357
    assert len(StatusSession(robot(), options("3.8.5")).frame(0.0)) == STATUS_433.size + 2


def test_port_8083_serves_one_client_until_it_is_gone() -> None:
    virtual = robot()
    first, second = (StatusSession(virtual, options("all")) for _ in range(2))
    assert [len(first.due(0.1 * n)) + 2 * len(second.due(0.1 * n)) for n in range(10)] == [1] * 10
    assert second.due(1.0) == []
    assert len(second.due(2.0)) == 1
    assert first.due(2.05) == []


def test_the_frame_counter_wraps() -> None:
    session = LegacySession(robot(), options("all"))
    assert [session.frame(0.008 * number)[2] for number in range(258)][-3:] == [255, 0, 1]


def rpc(call: Callable[[xmlrpc.client.ServerProxy], object], port: int) -> object:
    with xmlrpc.client.ServerProxy(f"http://{HOST}:{port}/RPC2") as proxy:
        return call(proxy)


async def test_xml_rpc_answers_what_the_vendors_client_asks() -> None:
    def talk(proxy: xmlrpc.client.ServerProxy) -> list[object]:
        return [
            proxy.GetControllerIP(),
            proxy.GetRobotRealtimeStateSamplePeriod(),
            proxy.SetRobotRealtimeStateSamplePeriod(40),
            proxy.GetRobotRealtimeStateSamplePeriod(),
            proxy.SetRobotRealtimeStateSamplePeriod(0),
            proxy.GetRobotStopOnComDisc(3),
        ]

    async with serve(SIMULATOR, host=HOST, port=0, options=options("3.8.7")) as (controller,):
        port = controller.ports[3][1]
        assert await asyncio.to_thread(rpc, talk, port) == [[0, "192.168.58.2"], [0, 8], 0, [0, 40], 4, [0, 0, 0]]
        with pytest.raises(xmlrpc.client.Fault):
            await asyncio.to_thread(rpc, lambda proxy: proxy.MoveJ([0]), port)
        assert LegacySession(controller.robot, controller.options).period_s == 0.04


def test_a_request_in_pieces_is_answered_once_whole() -> None:
    session = RpcSession(robot(), FairinoOptions(), sample_period=lambda: 0.008)
    body = xmlrpc.client.dumps((), "GetControllerIP").encode()
    request = b"POST /RPC2 HTTP/1.1\r\nHost: x\r\ncontent-length: %d\r\n\r\n" % len(body) + body
    answers = [session.received(request[at : at + 1], 0.0) for at in range(len(request))]
    assert [len(found) for found in answers] == [*[0] * (len(request) - 1), 1]
    assert answers[-1][0].startswith(b"HTTP/1.1 200 OK\r\n")
    assert len(session.received(request * 2, 0.0)) == 2


def test_a_request_without_end_is_refused() -> None:
    session = RpcSession(robot(), FairinoOptions(), sample_period=lambda: 0.008)
    with pytest.raises(ValueError, match="more than"):
        session.received(b"x" * 70_000, 0.0)


async def read_events(controller: VirtualController, protocol: Protocol, frames: int) -> list[Event]:
    """Read until so many good frames have come."""
    reader, writer = await asyncio.open_connection(HOST, dict(controller.ports)[protocol.name])
    decoder = protocol.reader()
    events: list[Event] = []
    while sum(isinstance(event, Frame) for event in events) < frames:
        data = await reader.read(65536)
        assert data
        events += decoder.feed(data)
    writer.close()
    await writer.wait_closed()
    return events


@pytest.mark.parametrize("name", ["checksum", "tail", "corrupt", "header", "junk", "split", "double"])
async def test_chaos_costs_frames_and_never_makes_a_false_one(
    name: Literal["checksum", "tail", "corrupt", "header", "junk", "split", "double"],
) -> None:
    served = serve(
        SIMULATOR, host=HOST, port=0, options=options("3.8.7", period_ms=1), chaos=f"{name}=0.3", seed=5, keep=10_000
    )
    async with served as (controller,):
        events = await read_events(controller, LEGACY, 60)
        assert controller.robot.faults[name] > 5
        sent = {sent.frame for sent in controller.robot.sent}
    assert {event.raw for event in events if isinstance(event, Frame)} <= sent
    rejected = {event.reason for event in events if isinstance(event, Reject)}
    assert bool(rejected) == (name not in {"split", "double"})


async def test_a_client_that_closes_its_own_side_goes_on_reading() -> None:
    async with serve(SIMULATOR, host=HOST, port=0, options=options("3.8.7")) as (controller,):
        reader, writer = await asyncio.open_connection(HOST, dict(controller.ports)["legacy"])
        writer.write_eof()
        raw = await reader.readexactly(1236 * 20)
        writer.close()
        await writer.wait_closed()
    assert len(LEGACY.reader().feed(raw)) == 20
