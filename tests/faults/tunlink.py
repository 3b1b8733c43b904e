"""A bad network in user space: joins this network namespace and another by TUN devices; netem is not in every kernel.

Each packet may be lost, late, doubled, out of order, damaged, or cut off with all the others; what happens can be
changed at any time. Runs on the loop of whoever opens it; needs root.
"""

from __future__ import annotations

import asyncio
import ctypes
import fcntl
import os
import struct
import subprocess
import threading
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random

_TUNSETIFF = 0x400454CA
_IFF_TUN_NO_PI = 0x0001 | 0x1000
_CLONE_NEWNET = 0x40000000
_MOST_BYTES = 65_536
_MOST_IN_A_TURN = 64
_HEADERS = 28  # of IP and UDP: damage to them is only loss


@dataclass(frozen=True, slots=True, kw_only=True)
class Weather:
    """What happens to packets, in both directions.

    Attributes:
        delay_s: How late each is.
        jitter_s: By how much more or less.
        loss: Share that is lost, 0 to 1.
        duplicate: Share that comes twice.
        reorder: Share that is not delayed, and so overtakes the others.
        corrupt: Share with one bit wrong.
        cut: Nothing gets through.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    corrupt: float = 0.0
    cut: bool = False

    def deliveries(self, packet: bytes, random: Random, counts: Counter[str]) -> list[tuple[float, bytes]]:
        """What becomes of a packet.

        Args:
            packet: It.
            random: Decides.
            counts: Counts what happened, by name.

        Returns:
            Each delivery: after how many s, and the bytes.
        """
        if self.cut or random.random() < self.loss:
            counts["lost"] += 1
            return []
        after_s = max(0.0, self.delay_s + random.uniform(-self.jitter_s, self.jitter_s))
        if random.random() < self.reorder:
            counts["reordered"] += 1
            after_s = 0.0
        if random.random() < self.corrupt:
            counts["corrupted"] += 1
            packet = _damaged(packet, random)
        n_times = 1
        if random.random() < self.duplicate:
            counts["duplicated"] += 1
            n_times = 2
        return [(after_s, packet)] * n_times


FAIR = Weather()


def _damaged(packet: bytes, random: Random) -> bytes:
    at = random.randrange(min(_HEADERS, len(packet) - 1), len(packet))
    return packet[:at] + bytes([packet[at] ^ 1 << random.randrange(8)]) + packet[at + 1 :]


class TunLink:
    """Carries packets between two TUN devices.

    Args:
        one: File descriptor of a TUN device.
        other: That of the other.
        seed: For what is random.

    Attributes:
        weather: What happens now.
        counts: What has happened, by name.
    """

    def __init__(self, one: int, other: int, seed: int = 0) -> None:
        self.weather = FAIR
        self.counts: Counter[str] = Counter()
        self._pairs = {one: other, other: one}
        self._random = Random(seed)  # noqa: S311 - weather, no secret
        self._loop = asyncio.get_running_loop()
        self._open = True

    def start(self) -> None:
        """Begin to carry."""
        for fd in self._pairs:
            self._loop.add_reader(fd, self._carry, fd)

    def stop(self) -> None:
        """Carry no more."""
        self._open = False
        for fd in self._pairs:
            self._loop.remove_reader(fd)

    def _carry(self, fd: int) -> None:
        for _ in range(_MOST_IN_A_TURN):
            try:
                packet = os.read(fd, _MOST_BYTES)
            except BlockingIOError:
                return
            self.counts["packets"] += 1
            for after_s, data in self.weather.deliveries(packet, self._random, self.counts):
                if after_s:
                    self._loop.call_later(after_s, self._write, self._pairs[fd], data)
                else:
                    self._write(self._pairs[fd], data)

    def _write(self, fd: int, data: bytes) -> None:
        if not self._open:
            return
        try:
            os.write(fd, data)
        except OSError:  # the queue of the device is full, or it is down
            self.counts["lost"] += 1


@asynccontextmanager
async def tunlink(namespace: str, name: str, here: str, there: str, seed: int = 0) -> AsyncIterator[TunLink]:
    """Join this network namespace and another while the context lasts.

    Args:
        namespace: The other, of `ip netns`.
        name: Of both devices.
        here: Address with prefix length of this end.
        there: That of the other.
        seed: For what is random.
    """
    with ExitStack() as stack:
        fds = []
        for where, address in ((None, here), (namespace, there)):
            fd = _in_namespace(where, lambda: _opened(name))
            stack.callback(os.close, fd)
            fds.append(fd)
            command = ["ip", *(("-n", where) if where else ())]
            run(*command, "addr", "add", address, "dev", name)
            run(*command, "link", "set", name, "up")
        link = TunLink(fds[0], fds[1], seed)
        link.start()
        try:
            yield link
        finally:
            link.stop()


def run(*command: str, text: str | None = None) -> None:
    """Run a command of the system.

    Raises:
        CalledProcessError: It failed.
    """
    subprocess.run(command, check=True, capture_output=True, input=text, text=True)  # noqa: S603


def _opened(name: str) -> int:
    """Make a TUN device in the thread's namespace."""
    fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(fd, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN_NO_PI))
    except OSError:
        os.close(fd)
        raise
    return fd


def _in_namespace(namespace: str | None, call: Callable[[], int]) -> int:
    """Call something in a network namespace: in a thread of its own, which ends in it."""
    found: list[int | OSError] = []

    def enter_and_call() -> None:
        try:
            if namespace is not None:
                with Path("/run/netns", namespace).open("rb") as handle:
                    libc = ctypes.CDLL(None, use_errno=True)
                    if libc.setns(handle.fileno(), _CLONE_NEWNET):
                        raise OSError(ctypes.get_errno(), f"cannot enter the namespace {namespace}")  # noqa: TRY301
            found.append(call())
        except OSError as error:
            found.append(error)

    thread = threading.Thread(target=enter_and_call)
    thread.start()
    thread.join()
    (result,) = found
    if isinstance(result, OSError):
        raise result
    return result
