"""A virtual controller that calls a gateway, like one that is configured as a TCP client.

One task of the controller makes the calls, one after the other; what is said on them is said by the loop's callbacks.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import anyio
from anyio.abc import TaskGroup

from gateway.sim.connection import Connection

RETRY_S = 0.2


class Caller:
    """Calls one gateway from one address for as long as it is started, and again whenever it hung up or is not there.

    Args:
        make: Makes the connection of one call from what it calls when it is lost.
        host: The controller's own address: the gateway knows it by that.
        gateway: Whom it calls: host and port.
    """

    def __init__(self, make: Callable[[Callable[[], None]], Connection], host: str, gateway: tuple[str, int]) -> None:
        self._make = make
        self._host = host
        self._gateway = gateway
        self._scope = anyio.CancelScope()
        self._ended = anyio.Event()

    def start(self, tasks: TaskGroup) -> None:
        """Begin to call.

        Args:
            tasks: Where the calls are made.

        Raises:
            OSError: This machine does not have the controller's address.
        """
        with socket.socket(socket.AF_INET6 if ":" in self._host else socket.AF_INET) as trial:
            trial.bind((self._host, 0))
        tasks.start_soon(self._run, name=f"calls {self._gateway} from {self._host}")

    def cancel(self) -> None:
        """Call no more; see `ended`."""
        self._scope.cancel()

    async def ended(self) -> None:
        """Wait until no call is being made."""
        await self._ended.wait()

    async def _run(self) -> None:
        try:
            with self._scope:
                while True:
                    await self._call()
                    await anyio.sleep(RETRY_S)
        finally:
            self._ended.set()

    async def _call(self) -> None:
        """Call, and wait until the connection has ended; it ends when this is cancelled."""
        lost = anyio.Event()
        connection = self._make(lost.set)
        call = asyncio.get_running_loop().create_connection(
            lambda: connection, *self._gateway, local_addr=(self._host, 0)
        )
        try:
            transport, _ = await call
            if not _is_itself(transport):
                await lost.wait()
        except OSError:
            return  # nobody listens yet, or no longer
        finally:
            connection.abort()
            connection.connection_lost(None)  # of a call that was cancelled uvloop does not say it


def _is_itself(transport: asyncio.Transport) -> bool:
    """Whether the system has joined a call to its own port: it may where nobody listens on this very address."""
    return bool(transport.get_extra_info("sockname") == transport.get_extra_info("peername"))
