"""foxglove-sdk's server (Rust), publishing the same bytes on as many channels as there are robots.

    python -m tests.bench.servers.sdk COUNT RATE_HZ aligned|spread ENCODING FILE

It reads no robot and encodes nothing: FILE has the payload. It tells its port, and ends with its standard input.
"""

from __future__ import annotations

import os
import select
import sys
from pathlib import Path
from typing import cast

import foxglove

from tests.bench.schedule import Phases, turns


def run(count: int, rate_hz: float, phases: Phases, encoding: str, payload: bytes) -> None:
    """Publish until the standard input ends."""
    foxglove.set_log_level("CRITICAL")
    server = foxglove.start_server(host="127.0.0.1", port=0)
    schema = foxglove.Schema(name="joints", encoding="jsonschema", data=b'{"type":"object"}')
    topics = [f"/r{number}/joints" for number in range(1, count + 1)]
    channels = [foxglove.Channel(topic, message_encoding=encoding, schema=schema) for topic in topics]
    print(server.port, flush=True)
    for number, group in enumerate(turns(count, rate_hz, phases)):
        for robot in group:
            channels[robot].log(payload)
        if number % 100 == 0 and select.select([0], [], [], 0)[0]:
            os._exit(0)


if __name__ == "__main__":
    _, robots, rate, phasing, kind, file = sys.argv
    run(int(robots), float(rate), cast("Phases", phasing), kind, Path(file).read_bytes())
