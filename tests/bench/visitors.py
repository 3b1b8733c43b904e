"""Clients that come and go: each stays a moment, reads what it is sent, and makes room for the next.

    python -m tests.bench.visitors PORT COUNT

It says `ready` when all are there, and for each line that it is told how many have come so far.
"""

from __future__ import annotations

import os
import random
import select
import socket
import sys
import time

from tests.bench.dialects import DIALECTS, join

_STAY_S = (0.5, 4.0)
_SWEEP_S = 0.01
_BUFFER = bytearray(1 << 18)


def run(port: int, count: int) -> None:
    """Come and go until the standard input ends."""
    chance = random.Random(7)  # noqa: S311 - a load, no secret
    here: dict[socket.socket, float] = {}
    n_came = 0
    ready = False
    while True:
        began_s = time.monotonic()
        gone = [sock for sock, until_s in here.items() if until_s < began_s or not _swept(sock)]
        for sock in gone:
            del here[sock]
            sock.close()
        for _ in range(min(4, count - len(here))):  # so many in one sweep: nobody waits long meanwhile
            sock, _ = join(port, DIALECTS["json" if n_came % 2 else "msgpack"], ("*/joints", "*/status"))
            sock.setblocking(False)  # noqa: FBT003 - its signature
            here[sock] = began_s + chance.uniform(*_STAY_S)
            n_came += 1
        if not ready and len(here) == count:
            ready = True
            print("ready", flush=True)
        if select.select([0], [], [], 0)[0]:
            if not os.read(0, 4096):
                return
            print(n_came, flush=True)
        time.sleep(max(0.0, began_s + _SWEEP_S - time.monotonic()))


def _swept(sock: socket.socket) -> bool:
    """Read what is there; whether the server is."""
    try:
        return sock.recv_into(_BUFFER) > 0
    except BlockingIOError:
        return True
    except ConnectionError:
        return False


if __name__ == "__main__":
    run(int(sys.argv[1]), int(sys.argv[2]))
