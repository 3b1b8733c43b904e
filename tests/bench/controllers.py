"""Virtual FAIRINO controllers that cost almost nothing: frames of CNDE made beforehand, of which each gets its number.

    python -m tests.bench.controllers COUNT RATE_HZ aligned|spread

It tells its ports as one line of JSON, and for each line that it is told how many frames have left. Each frame carries
the monotonic time at which it left, in s, in the place of the first joint's position in degrees: every process of the
machine has the same clock, so that a reader of the value knows how long it was under way.
"""

from __future__ import annotations

import os
import selectors
import socket
import struct
import sys
import time
from typing import cast

import msgspec

from gateway.api.layout import Layout
from gateway.sim.scenario import find_scenario
from gateway.sim.simulator import VirtualRobot
from tests.bench.schedule import Phases, turns
from vendors.fairino.cnde_wire import COUNTER_AT
from vendors.fairino.simulator.cnde import CndeBehaviour, CndeSession
from vendors.fairino.simulator.values import Writer

STAMPED = "jt_cur_pos"
_FRAMES = 125  # so many different frames are sent in a row
_LOOK_S = 0.004  # how often new bytes and clients are looked for


class Told(msgspec.Struct):
    """What the controllers have done so far.

    Attributes:
        sent: Frames that left.
        blocked: Frames that were left out because the reader did not read.
    """

    sent: int = 0
    blocked: int = 0


class Peer:
    """Who reads one controller.

    Args:
        sock: Accepted, not blocking.
        told: Where frames are counted.
    """

    def __init__(self, sock: socket.socket, told: Told) -> None:
        self.sock = sock
        self._told = told
        self._layout: Layout | None = None
        self._session = CndeSession(VirtualRobot(find_scenario("steady")), CndeBehaviour(), self._writer)
        self._frames: list[bytearray] = []
        self._stamp_at = 0
        self._number = 0
        self._rest = b""

    def _writer(self, layout: Layout) -> Writer:
        self._layout = layout
        return Writer(layout)

    def read(self) -> bool:
        """Take part in the handshake; whether the reader is still there."""
        try:
            data = self.sock.recv(65536)
            for answer in self._session.received(data, 0.0) if data else ():
                self.sock.send(answer)
        except OSError:
            return False
        if self._session.period_s is None:
            self._frames = []
        elif not self._frames and self._layout is not None:
            self._frames = [bytearray(self._session.due(0.008 * number)[0]) for number in range(_FRAMES)]
            self._stamp_at = self._layout.by_name[STAMPED].offset
        return bool(data)

    def push(self) -> None:
        """Send the next frame, unless the reader does not read."""
        if not self._frames:
            return
        frame = self._frames[self._number % _FRAMES]
        struct.pack_into("<d", frame, self._stamp_at, time.monotonic())
        frame[COUNTER_AT] = (self._number + 1) & 0xFF
        try:
            if self._rest:
                self._rest = self._rest[self.sock.send(self._rest) :]
            if self._rest:
                self._told.blocked += 1
                return
            n_sent = self.sock.send(frame)
        except BlockingIOError:
            self._told.blocked += 1
            return
        except OSError:
            self._frames = []
            return
        self._rest = bytes(frame[n_sent:])
        self._number += 1
        self._told.sent += 1


class Controllers:
    """All controllers of a load.

    Args:
        count: How many.
    """

    def __init__(self, count: int) -> None:
        self._selector = selectors.DefaultSelector()
        self._peers: list[list[Peer]] = [[] for _ in range(count)]
        self._told = Told()
        self.ports = []
        for number in range(count):
            listener = socket.create_server(("127.0.0.1", 0))
            listener.setblocking(False)  # noqa: FBT003 - its signature
            self.ports.append(int(listener.getsockname()[1]))
            self._selector.register(listener, selectors.EVENT_READ, number)
        self._selector.register(0, selectors.EVENT_READ, None)

    def look(self) -> bool:
        """Take new readers, what they say, and what the standard input says; whether to go on."""
        for key, _ in self._selector.select(0):
            if key.data is None:
                if not os.read(0, 4096):
                    return False
                sys.stdout.buffer.write(msgspec.json.encode(self._told) + b"\n")
                sys.stdout.flush()
            elif isinstance(key.data, int):
                self._accept(cast("socket.socket", key.fileobj), key.data)
            else:
                number, peer = cast("tuple[int, Peer]", key.data)
                if not peer.read():
                    self._selector.unregister(peer.sock)
                    self._peers[number].remove(peer)
                    peer.sock.close()
        return True

    def _accept(self, listener: socket.socket, number: int) -> None:
        sock, _ = listener.accept()
        sock.setblocking(False)  # noqa: FBT003 - its signature
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer = Peer(sock, self._told)
        self._peers[number].append(peer)
        self._selector.register(sock, selectors.EVENT_READ, (number, peer))

    def serve(self, rate_hz: float, phases: Phases) -> None:
        """Send until the standard input ends."""
        look_s = 0.0
        for group in turns(len(self.ports), rate_hz, phases):
            for number in group:
                for peer in self._peers[number]:
                    peer.push()
            now_s = time.monotonic()
            if now_s >= look_s:
                look_s = now_s + _LOOK_S
                if not self.look():
                    return


if __name__ == "__main__":
    _, asked, rate, phasing = sys.argv
    controllers = Controllers(int(asked))
    sys.stdout.buffer.write(msgspec.json.encode(controllers.ports) + b"\n")
    sys.stdout.flush()
    controllers.serve(float(rate), cast("Phases", phasing))
