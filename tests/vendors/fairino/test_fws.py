"""Others' code on port 8083: fairino-fws reads our virtual controller, and `status` reads its fake one.

Each runs in a process of its own, which a time limit kills.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from math import radians

import pytest

from gateway.api.decoder import Event, Frame, Reject
from gateway.api.model import Joints, Quality, Status, Tcp, Wrench
from gateway.api.normaliser import Normaliser
from gateway.sim.server import serve
from gateway.sim.simulator import Sent
from vendors.fairino.pushed import STATUS
from vendors.fairino.simulator import SIMULATOR
from vendors.fairino.simulator.values import PROGRAM

LIMIT_S = 15.0
HOST = "127.0.0.1"

_TELEMETRY = """
import json, sys, time
from fws.telemetry import Telemetry

telemetry = Telemetry(sys.argv[1], int(sys.argv[2]))
telemetry.start()
found = {}
end = time.monotonic() + 10
while time.monotonic() < end and len(found) < int(sys.argv[3]):
    state = telemetry.snapshot()
    if state["frames"] and state["frames"] not in found:
        found[state["frames"]] = state
    time.sleep(0.005)
telemetry.close()
print(json.dumps(list(found.values())))
"""

_FAKE = """
import json, sys
from fws.testing.fake_controller import FakeController

with FakeController(stream_hz=50.0) as fake:
    fake.state.joints = [10.5, -75.25, 88.0, -101.5, -90.125, 33.75]
    fake.state.joint_torque = [1.5, -62.25, 30.125, -4.5, 0.75, 0.25]
    fake.state.ft = [1.25, -0.5, -9.5, 0.05, -0.02, 0.01]
    fake.state.program_state = 2
    print(json.dumps({"port": fake.stream_port, "tcp": fake.state.tcp()}), flush=True)
    for line in sys.stdin:
        fake.corrupt_next_frame(int(line))
"""


@asynccontextmanager
async def script(code: str, *arguments: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run a script in a process of its own for as long as the context lasts."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", code, *arguments, stdin=pipe, stdout=pipe)
    try:
        async with asyncio.timeout(LIMIT_S):
            yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


async def telemetry(port: int, frames: int) -> list[Mapping[str, object]]:
    """What fairino-fws reads on a port."""
    async with script(_TELEMETRY, HOST, str(port), str(frames)) as process:
        out, _ = await process.communicate()
    found: list[Mapping[str, object]] = json.loads(out)
    return found


def meant(sent: Sent) -> dict[str, object]:
    """The values of a sent frame as fairino-fws names, scales and rounds them."""
    values = sent.values()

    def rounded(name: str, digits: int, scale: float = 1.0) -> list[float]:
        items = values[name]
        assert isinstance(items, list)
        return [round(item / scale, digits) for item in items]

    return {
        "counter": values["frame_cnt"],
        "program_state": values["program_state"],
        "joints": rounded("jt_cur_pos", 4),
        "tcp": rounded("tl_cur_pos", 3),
        "joint_torque": rounded("jt_cur_tor", 5, 1000.0),
        "ft": rounded("ft_sensor_data", 4),
        "loaded_program_truncated": PROGRAM,
    }


async def test_fairino_fws_reads_what_the_virtual_controller_means() -> None:
    async with serve(SIMULATOR, host=HOST, port=0, scenario="steady", keep=200) as (controller,):
        read = await telemetry(controller.number_of("status"), 8)
        sent = {sent.frame[2]: meant(sent) for sent in controller.robot.sent if len(sent.frame) == 433}
    assert len(read) == 8
    assert read[-1]["bad_checksum"] == 0
    for state in read:
        wanted = sent[state["counter"]]  # type: ignore[index] # a number
        assert {name: state[name] for name in wanted} == wanted


async def test_fairino_fws_counts_our_wrong_checksums() -> None:
    served = serve(SIMULATOR, host=HOST, port=0, scenario="steady", chaos="checksum=0.4", seed=3)
    async with served as (controller,):
        read = await telemetry(controller.number_of("status"), 8)
        assert 0 < int(str(read[-1]["bad_checksum"])) <= controller.robot.faults["checksum"]


async def read_status(port: int, frames: int) -> list[Event]:
    """What `status` reads on a port until so many good frames have come."""
    reader, writer = await asyncio.open_connection(HOST, port)
    decoder = STATUS.reader()
    events: list[Event] = []
    while sum(isinstance(event, Frame) for event in events) < frames:
        data = await reader.read(65536)
        assert data, "the fake controller closed the stream"
        events += decoder.feed(data)
    writer.close()
    await writer.wait_closed()
    return events


async def test_status_reads_the_fake_controller_of_fairino_fws() -> None:
    async with script(_FAKE) as process:
        assert process.stdout is not None
        said = json.loads(await process.stdout.readline())
        events = await read_status(said["port"], 5)
    assert all(isinstance(event, Frame) for event in events)
    frame = events[-1]
    assert isinstance(frame, Frame)
    assert (frame.layout.name, frame.quality) == ("433", Quality.GOOD)
    readers = Normaliser(STATUS.signals, {"estop_polarity": None}).readers(frame.layout)
    joints, tcp, wrench, status = (readers[name].read(frame)[0] for name in ("joints", "tcp", "wrench", "status"))
    assert isinstance(joints, Joints)
    assert joints.position == pytest.approx([radians(a) for a in (10.5, -75.25, 88.0, -101.5, -90.125, 33.75)])
    assert joints.effort == pytest.approx([1.5, -62.25, 30.125, -4.5, 0.75, 0.25])
    assert isinstance(tcp, Tcp)
    assert tcp.pose is not None
    assert tcp.pose.position == pytest.approx([one / 1000 for one in said["tcp"][:3]])
    assert isinstance(wrench, Wrench)
    assert (wrench.force, wrench.torque) == ([1.25, -0.5, -9.5], [0.05, -0.02, 0.01])
    assert isinstance(status, Status)
    assert status.program is not None
    assert (status.program.state, status.program.name) == ("RUNNING", None)  # the fake names no program


async def test_status_rejects_the_corrupt_frames_of_the_fake_controller() -> None:
    async with script(_FAKE) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        said = json.loads(await process.stdout.readline())
        process.stdin.write(b"3\n")
        await process.stdin.drain()
        events = await read_status(said["port"], 40)
    assert [event.reason for event in events if isinstance(event, Reject)] == ["checksum"] * 3
