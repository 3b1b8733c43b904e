"""Clients that others wrote read the virtual controller: the vendor's own SDK, and a strict one.

Both block without end when an answer fails to come, so each runs in a process of its own, which a time limit kills.
"""

from __future__ import annotations

import asyncio
import importlib.util
import json
import sys
from collections.abc import Mapping
from typing import cast

import numpy as np
import pytest

from gateway.sim.server import serve
from vendors.rainbow.layouts import STATE_580
from vendors.rainbow.simulator import SIMULATOR

LIMIT_S = 15.0
REQUESTS = 400

_RBPODO = """
import json, sys
import rbpodo

host, port, requests = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
channel = rbpodo.CobotData(host, port)
names = [name for name in dir(rbpodo.SystemState.Data) if not name.startswith("_")]
for _ in range(requests):
    data = channel.request_data(5.0).sdata
    values = {}
    for name in names:
        value = getattr(data, name)
        values[name] = value if isinstance(value, (int, float)) else [item for item in value]
    print(json.dumps(values, default=lambda item: item.item()))
"""

_RB_API = """
import json, os, sys, time
from rainbow import cobot

assert cobot.ConnectToCB(sys.argv[1])
seen = None
found = []
while len(found) < int(sys.argv[2]):
    state = cobot.systemstat_global
    if state is not seen and state.time is not None:
        seen = state
        found.append(vars(state))
    time.sleep(0.0005)
print(json.dumps(found))
sys.stdout.flush()
os._exit(0)  # its threads never end
"""

# rb-api's names of an older manual -> those of the table
_OLD_NAMES = {
    "cur": "jnt_cur",
    "temperature_mc": "jnt_temperature",
    "power_state": "information_chunk_1",
    "tcp_target": "reserved_1",
    "program_mode": "real_vs_simulation_mode",
}
# rb-api reads the run time as a float, and two words as an array
_OLD_TYPES = {"task_run_time", "digital_in_config"}


def unsigned(name: str, value: object) -> object:
    """The same bits without a sign: clients disagree on which words have one."""
    if STATE_580.by_name[name].is_float:
        return value
    if isinstance(value, list):
        return [word % 2**32 for word in value]
    return cast("int", value) % 2**32


def wrongly_read(meant: Mapping[str, object], read: Mapping[str, object]) -> dict[str, tuple[object, object]]:
    """What a client read otherwise than the simulator meant it, to the precision of the wire."""
    pairs = {name: (unsigned(name, meant[name]), unsigned(name, value)) for name, value in read.items()}
    return {name: pair for name, pair in pairs.items() if pair[1] != pytest.approx(pair[0], rel=1e-6)}


async def run(script: str, *arguments: str) -> str:
    """Run a client in its own process."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", script, *arguments, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    try:
        out, err = await asyncio.wait_for(process.communicate(), LIMIT_S)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode == 0, err.decode()
    return out.decode()


@pytest.mark.skipif(importlib.util.find_spec("rbpodo") is None, reason="rbpodo has no wheel for this platform")
async def test_the_vendors_own_client_reads_every_field_as_it_was_meant() -> None:
    async with serve(SIMULATOR, host="127.0.0.1", port=0, scenario="steady", keep=REQUESTS) as (controller,):
        out = await run(_RBPODO, controller.host, str(controller.port), str(REQUESTS))
        robot = controller.robot
    read = [json.loads(line) for line in out.splitlines()]
    assert len(read) == robot.requests == robot.frames == REQUESTS
    names = set(STATE_580.by_name) - {"header"}
    for values, sent in zip(read, robot.sent, strict=True):
        assert set(values) == names
        assert wrongly_read(sent.values(), values) == {}


async def test_a_client_that_is_strict_about_the_size_reads_it_too() -> None:
    frames = 20
    # Its ports are fixed, so this controller needs an address of its own.
    async with serve(SIMULATOR, host="127.0.0.77", scenario="steady", keep=200_000) as (controller,):
        assert controller.ports == (("reqdata", 5001), (None, 5000))
        out = await run(_RB_API, controller.host, str(frames))
        robot = controller.robot
    read = json.loads(out.splitlines()[-1])  # it greets first
    assert len(read) == frames
    sent_with = {tuple(np.frombuffer(sent.frame[8:32], "<f4").tolist()): sent for sent in robot.sent}
    for values in read:
        named = {_OLD_NAMES.get(name, name): value for name, value in values.items() if name not in _OLD_TYPES}
        assert wrongly_read(sent_with[tuple(values["jnt_ref"])].values(), named) == {}
