"""The process that writes one recording, as the gateway sees it."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import anyio
import anyio.abc
import msgspec

import gateway
from gateway.record.spool import Message, Outcome, encode

# A process that takes nothing for so long is given up; when it has everything it may still have much to write.
STUCK_S = 60.0
FINISH_S = 900.0
_LONGEST_ANSWER = 1 << 20
# The process runs where its code lies: a folder `gateway` in the current one would be taken for it.
_CODE = Path(gateway.__file__).parents[1]


class Filing:
    """Hands a recording over.

    Args:
        process: Writes it.

    Attributes:
        broken: Whether it takes no more: what it says at its end tells why.
    """

    def __init__(self, process: anyio.abc.Process) -> None:
        self._process = process
        self.broken = False

    @classmethod
    @asynccontextmanager
    async def opened(cls, path: Path) -> AsyncIterator[Filing]:
        """Start the process; one that is left before it has finished is ended, and leaves no file.

        Raises:
            OSError: It cannot be started.
        """
        process = await anyio.open_process(_command(path), stderr=None, cwd=_CODE)
        try:
            yield cls(process)
        finally:
            with anyio.CancelScope(shield=True):
                await _closed(process)

    async def send(self, message: Message) -> None:
        """Hand one message over."""
        if self._process.stdin is None:
            raise ValueError("the process takes nothing")
        try:
            with anyio.fail_after(STUCK_S):
                await self._process.stdin.send(encode(message))
        except (anyio.BrokenResourceError, anyio.ClosedResourceError, TimeoutError, OSError):
            self.broken = True

    def kill(self) -> None:
        """End the process at once; it leaves no file."""
        self.broken = True
        with suppress(ProcessLookupError):
            self._process.kill()

    async def finished(self) -> Outcome:
        """Wait until the file is there, or it is known why not."""
        process = self._process
        if process.stdin is None or process.stdout is None:
            raise ValueError("the process tells nothing")
        await process.stdin.aclose()
        told = bytearray()
        try:
            with anyio.fail_after(FINISH_S):
                async for data in process.stdout:
                    told += data[: _LONGEST_ANSWER - len(told)]
                await process.wait()
        except TimeoutError:
            return Outcome(error=f"the process that writes it did not end within {FINISH_S:g} s")
        try:
            return msgspec.json.decode(bytes(told), type=Outcome)
        except msgspec.DecodeError:
            return Outcome(error=f"the process that writes it has ended with exit code {process.returncode}")


def _command(path: Path) -> list[str]:
    return [sys.executable, "-m", "gateway.record", str(path.absolute())]


async def _closed(process: anyio.abc.Process) -> None:
    """End a process that is still there: at the end of its input it leaves no file and goes."""
    if process.stdin is not None:
        await process.stdin.aclose()
    with anyio.move_on_after(1):
        await process.wait()
    if process.returncode is None:
        process.kill()
        await process.wait()
    if process.stdout is not None:
        await process.stdout.aclose()
