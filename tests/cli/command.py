"""Runs the command line as a user does, against a gateway with a virtual robot on free ports."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import anyio

from gateway.app import Gateway, running
from gateway.config import parse
from gateway.core.registry import Registry
from gateway.sim.server import serve
from gateway.sim.simulator import Simulator

ROOT = Path(__file__).parents[2]
PYTHON = [sys.executable, "-m", "gateway"]


@dataclass(frozen=True, slots=True)
class Finished:
    """What a command has left."""

    code: int
    out: str
    err: str


def environment(**more: str) -> dict[str, str]:
    """The environment of a command: nothing of this machine's terminal and settings."""
    kept = {key: value for key, value in os.environ.items() if key not in {"COLUMNS", "LINES", "NO_COLOR"}}
    kept = {key: value for key, value in kept.items() if not key.startswith("ROBOT_GATEWAY_")}
    return {**kept, "PYTHONWARNINGS": "error", "PYTHONPATH": str(ROOT), **more}


async def command(*arguments: str, env: Mapping[str, str] | None = None, cwd: Path = ROOT) -> Finished:
    """Run `robot-gateway` to its end."""
    with anyio.fail_after(15):
        done = await anyio.run_process(
            [*PYTHON, *arguments], env=environment(**(env or {})), cwd=cwd, check=False, stdin=subprocess.DEVNULL
        )
    return Finished(done.returncode, done.stdout.decode(), done.stderr.decode())


def command_here(*arguments: str, env: Mapping[str, str] | None = None, cwd: Path = ROOT) -> Finished:
    """Run `robot-gateway` to its end, without a loop."""
    done = subprocess.run(  # noqa: S603
        [*PYTHON, *arguments],
        env=environment(**(env or {})),
        cwd=cwd,
        check=False,
        capture_output=True,
        text=True,
        timeout=15,
        stdin=subprocess.DEVNULL,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


@asynccontextmanager
async def running_cell(name: str = "r1", port: int = 0) -> AsyncIterator[Gateway]:
    """A gateway with one virtual Rainbow controller, online; on a port of its own or a given one."""
    registry = Registry()
    simulator = cast("Simulator", registry.simulator("rainbow"))
    async with serve(simulator, host="127.0.0.2", port=0, scenario="steady") as (controller,):
        text = f"""
            [server]
            listen = "127.0.0.1:{port}"
            [[robots]]
            name = "{name}"
            vendor = "rainbow"
            host = "{controller.host}"
            port = {controller.port}
        """
        async with running(parse(text, "test", registry)) as gateway:
            with anyio.fail_after(5):
                while gateway.bus.events.last_seq == 0:  # noqa: ASYNC110 - the bus has no event for it
                    await anyio.sleep(0.01)
            yield gateway
