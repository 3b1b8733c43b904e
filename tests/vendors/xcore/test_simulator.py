"""The virtual controller on real sockets: both protocols from one robot, both roles, chaos, options."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from typing import Any

import msgspec
import pytest

from gateway.sim import calling
from gateway.sim.scenario import Scenario, find_scenario
from gateway.sim.server import VirtualController, serve
from gateway.sim.simulator import VirtualRobot
from vendors.xcore.simulator import SIMULATOR
from vendors.xcore.simulator.external import ExternalSession
from vendors.xcore.simulator.objects import FILLERS, ObjectsSession
from vendors.xcore.simulator.options import XcoreOptions

HOST = "127.0.0.1"


def options(**values: object) -> XcoreOptions:
    return msgspec.convert(values, XcoreOptions)


def robot(scenario: str | Scenario = "steady", keep: int = 0) -> VirtualRobot:
    return VirtualRobot(find_scenario(scenario) if isinstance(scenario, str) else scenario, keep=keep)


def state_of(of: VirtualRobot, at_s: float, **values: object) -> dict[str, Any]:
    """The state that the agent sends at a time."""
    line = ObjectsSession(of, options(**values)).due(at_s)[-1]
    found: dict[str, Any] = json.loads(line)
    assert found["type"] == "state"
    return found


def numbers_of(of: VirtualRobot, word: str, at_s: float, **values: object) -> list[float]:
    (answer,) = ExternalSession(of, options(**values)).received(word.encode() + b"\r", at_s)
    return [float(part) for part in answer.decode().removesuffix("\r").split(",")]


def test_the_ports_are_ours_and_external_communication_comes_first() -> None:
    assert [(port.protocol, port.port) for port in SIMULATOR.ports] == [("external", 4320), ("objects", 5920)]


def test_a_demo_reads_it_in_three_ways_with_the_settings_that_it_has() -> None:
    assert [demo.protocol for demo in SIMULATOR.demos] == ["external", "objects", "external"]
    usual = {"port": 4320, "estop_polarity": "active_high", "external": {"torque_unit": "Nm"}}
    assert (SIMULATOR.keys("external"), SIMULATOR.keys("objects")) == (usual, {})
    assert SIMULATOR.demos[2].robot["external"] == {"torque_unit": "Nm", "role": "server"}
    assert (XcoreOptions().estop_level, XcoreOptions().torque_unit) == ("high", "Nm")


def test_every_option_has_a_default_and_a_description() -> None:
    assert isinstance(SIMULATOR.options(), XcoreOptions)
    rows = msgspec.json.schema(XcoreOptions)["$defs"]["XcoreOptions"]["properties"]
    assert [name for name, row in rows.items() if not row.get("description") or "default" not in row] == []


@pytest.mark.parametrize(
    ("text", "wire"),
    [
        (r"\r", b"\r"),
        ("\r", b"\r"),
        (r"\r\n", b"\r\n"),
        (r"\t", b"\t"),
        ("#end#", b"#end#"),
        (r"\\", b"\\"),
        (r"\u3001", "、".encode()),
    ],
)
def test_a_suffix_may_be_written_with_escapes(text: str, wire: bytes) -> None:
    assert options(suffix=text).ending == wire


@pytest.mark.parametrize(
    "wrong",
    [
        {"suffix": ""},
        {"suffix": r"\x"},
        {"suffix": "\\"},
        {"external_calls": "127.0.0.1"},
        {"external_calls": ":4320"},
        {"external_calls": "127.0.0.1:0"},
        {"external_calls": "127.0.0.1:65536"},
        {"axes": 5},
        {"separator": "|"},
        {"objects_hz": 0.5},
        {"commands_hz": 5001},
        {"commands_per_list": 101},
    ],
)
def test_an_option_of_no_use_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        options(**wrong)


def test_the_gateway_to_call_is_a_host_and_a_port() -> None:
    assert options().gateway is None
    assert options(external_calls="gateway.cell:4320").gateway == ("gateway.cell", 4320)
    assert options(external_calls="[::1]:4320").gateway == ("::1", 4320)


@pytest.mark.parametrize("at_s", [0.0, 5.0, 17.3, 31.0, 64.5])
@pytest.mark.parametrize("axes", [6, 7])
def test_both_protocols_tell_one_robot_in_their_own_units(at_s: float, axes: int) -> None:
    of = robot("cell")
    state = state_of(of, at_s, axes=axes, extra_joints=2)

    def told(word: str) -> list[float]:
        return numbers_of(of, word, at_s, axes=axes, extra_joints=2)

    assert told("jnt_pos") == pytest.approx(state["jointPos"] + state["external"], abs=1e-9)
    assert told("jnt_vel") == pytest.approx([*state["jointVel"], 0, 0], abs=1e-9)
    assert told("jnt_trq") == pytest.approx([*state["jointTorque"], 0, 0], abs=1e-9)
    assert len(state["jointPos"]) == axes
    x, y, z, a, b, c, *quaternion = told("cart_pos")
    pose = [x / 1000, y / 1000, z / 1000, math.radians(a), math.radians(b), math.radians(c)]
    assert pose == pytest.approx(state["posture"]["flangeInBase"], abs=1e-9)
    assert state["posture"]["endInRef"] == state["posture"]["flangeInBase"]
    assert state["cartPosture"]["trans"] + state["cartPosture"]["rpy"] == state["posture"]["flangeInBase"]
    assert sum(part * part for part in quaternion) == pytest.approx(1)


def test_the_quaternion_turns_like_the_angles() -> None:
    """The third column of R = Rz·Ry·Rx, from the angles and from q1 = w, q2 to q4 = x, y, z."""
    _, _, _, a, b, c, w, x, y, z = numbers_of(robot(), "cart_pos", 4.2)
    rx, ry, rz = map(math.radians, (a, b, c))
    column = (
        math.cos(rz) * math.sin(ry) * math.cos(rx) + math.sin(rz) * math.sin(rx),
        math.sin(rz) * math.sin(ry) * math.cos(rx) - math.cos(rz) * math.sin(rx),
        math.cos(ry) * math.cos(rx),
    )
    assert (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)) == pytest.approx(column, abs=1e-9)


async def ask(controller: VirtualController, requests: bytes, answers: int) -> list[bytes]:
    reader, writer = await asyncio.open_connection(HOST, dict(controller.ports)["external"])
    writer.write(requests)
    found = [await reader.readuntil(b"\r") for _ in range(answers)]
    writer.close()
    await writer.wait_closed()
    return found


async def read_lines(controller: VirtualController, enough: int) -> list[dict[str, Any]]:
    reader, writer = await asyncio.open_connection(HOST, dict(controller.ports)["objects"])
    lines = [json.loads(await reader.readline()) for _ in range(enough)]
    writer.close()
    await writer.wait_closed()
    return lines


async def test_both_ports_serve_several_connections_at_once() -> None:
    async with serve(SIMULATOR, host=HOST, port=0, scenario="idle") as (controller,):
        results: list[list[bytes]] = []

        async def one() -> None:
            results.append(await ask(controller, b"jnt_pos\rtask_state\rcart_pos_name\r", 3))

        async with asyncio.TaskGroup() as tasks:
            for _ in range(4):
                tasks.create_task(one())
            lines = tasks.create_task(read_lines(controller, 5))
        assert all(found == results[0] for found in results)
        assert results[0][1] == b"ready\r"
        assert results[0][2].startswith(b"cart_pos : ")
        assert [line["type"] for line in lines.result()] == ["hello", "event", "state", "state", "state"]
        assert lines.result()[2]["jointPos"] == pytest.approx([float(part) for part in results[0][0].split(b",")])


async def test_as_a_client_it_calls_the_gateway_which_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calling, "RETRY_S", 0.01)
    answers: asyncio.Queue[bytes] = asyncio.Queue()

    async def gateway(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"operating_mode\rcurrent_prog\r")
        answers.put_nowait(await reader.readuntil(b"\r"))
        writer.close()
        await writer.wait_closed()

    async with await asyncio.start_server(gateway, HOST, 0) as server:
        number = server.sockets[0].getsockname()[1]
        calls = options(external_calls=f"{HOST}:{number}")
        async with serve(SIMULATOR, host="127.0.0.9", port=0, options=calls, scenario="steady") as (controller,):
            assert controller.calls == (("external", f"{HOST}:{number}"),)
            assert [protocol for protocol, _ in controller.ports] == ["objects"]
            async with asyncio.timeout(5):
                assert [await answers.get() for _ in range(2)] == [b"truevirtual_cell\r"] * 2  # it calls again


async def test_a_slow_controller_answers_each_word_later() -> None:
    slow = options(slow_ms=60)
    async with serve(SIMULATOR, host=HOST, port=0, options=slow) as (controller,):
        begin_s = asyncio.get_running_loop().time()
        await ask(controller, b"task_state\rtask_state\r", 2)
        assert 0.1 < asyncio.get_running_loop().time() - begin_s < 5


@pytest.mark.parametrize("fault", ["split", "coalesce", "skip", "double"])
async def test_chaos_that_damages_nothing_leaves_valid_lines(fault: str) -> None:
    quick = options(objects_hz=500, commands_hz=100)
    served = serve(
        SIMULATOR, host=HOST, port=0, options=quick, scenario="steady", chaos=f"{fault}=0.4", seed=3, keep=9999
    )
    async with served as (controller,):
        lines = await read_lines(controller, 120)
        sent = {json.loads(found.frame)["seq"] for found in controller.robot.sent}
        assert controller.robot.faults[fault]
    assert lines[0]["type"] == "hello"
    assert {line["seq"] for line in lines if line["type"] == "state"} <= sent
    repeated = len(lines) - len({json.dumps(line) for line in lines})
    assert (repeated > 0) == (fault in {"double", "skip", "coalesce"})
    assert any(line["type"] == "remark" for line in lines) == (fault in {"skip", "coalesce"})


async def test_an_agent_that_crashes_begins_a_new_connection_with_a_hello() -> None:
    async with serve(SIMULATOR, host=HOST, port=0, chaos="cut=0.1") as (controller,):
        for _ in range(2):
            reader, writer = await asyncio.open_connection(HOST, dict(controller.ports)["objects"])
            async with asyncio.timeout(5):
                first, second = json.loads(await reader.readline()), json.loads(await reader.readline())
                with contextlib.suppress(ConnectionResetError):
                    await reader.read()
            assert (first["type"], second["seq"]) == ("hello", 1)
            writer.close()


def test_fillers_are_whole_lines_of_a_type_that_the_schema_does_not_have() -> None:
    types = {"hello", "state", "event", "log", "issued", "lost", "command", "result"}
    for filler in FILLERS:
        assert filler.endswith(b"}\n")
        assert json.loads(filler)["type"] not in types
