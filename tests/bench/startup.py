"""How long it takes until the first sample, and until `robot-gateway status` has answered."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from gateway.testing.cell import free_port
from tests.bench import cells
from tests.bench.dialects import DIALECTS, join, received
from tests.bench.plan import Plan
from tests.bench.processes import ROOT, running
from tests.bench.table import Goal, Row, row_of

_PATIENCE_S = 20.0
_BARE = ["-c", "import aiohttp, typer"]


def rows(plan: Plan) -> Iterator[Row]:
    """Both beside the start of a Python that imports two of the packages."""
    first, status, bare = [], [], []
    with cells.controllers(1, plan.rate_hz) as (_, ports), cells.gateway(ports) as (_, port):
        for _ in range(plan.rounds):
            bare.append(_ran_s(_BARE))
            status.append(_ran_s(["-m", "gateway", "status", "--url", f"ws://127.0.0.1:{port}/ws"]))
            first.append(_first_sample_s(ports))
    base = 'python -c "import aiohttp, typer"'
    yield row_of(
        "robot-gateway status", "ms", [one * 1e3 for one in status], base, [one * 1e3 for one in bare], goal=Goal(3)
    )
    note = "with the vendor's handshake, of which 0.2 s are a wait for silence"
    yield row_of(
        "start to first sample", "ms", [one * 1e3 for one in first], base, [one * 1e3 for one in bare], note=note
    )


def _ran_s(arguments: list[str]) -> float:
    start_s = time.monotonic()
    subprocess.run(  # noqa: S603 - our own
        [sys.executable, *arguments], cwd=ROOT, check=True, stdout=subprocess.DEVNULL, timeout=_PATIENCE_S
    )
    return time.monotonic() - start_s


def _first_sample_s(ports: list[int]) -> float:
    """From the start of the process until a client has the first sample."""
    with tempfile.TemporaryDirectory() as folder:
        port, path = free_port(), Path(folder) / "gateway.toml"
        path.write_text(cells.configuration(port, ports), "utf-8")
        start_s = time.monotonic()
        with running(["-m", "gateway", "run", "--config", str(path), "--log-level", "error"]):
            while True:
                try:
                    sock, data = join(port, DIALECTS["json"], ("*/joints",))
                    break
                except ConnectionRefusedError:
                    assert time.monotonic() < start_s + _PATIENCE_S, "no gateway answers"
                    time.sleep(0.005)
            with sock:
                while b'"position":[' not in data:
                    data = data[-16:] + received(sock)
                return time.monotonic() - start_s
