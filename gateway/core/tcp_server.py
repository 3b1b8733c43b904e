"""TCP where the controller calls: the gateway listens and lets one peer in, but it is still the gateway that asks."""

from __future__ import annotations

import errno
import ipaddress
import socket
from collections import Counter
from collections.abc import Mapping, Sequence

import anyio
import anyio.lowlevel
from anyio.abc import SocketStream

from gateway.core.transport import CONNECT_TIMEOUT_S, Connection, TcpConnection, address_text, describe, prepare
from gateway.errors import LinkClosed

CALL_TIMEOUT_S = 10.0
# Calls that wait in the system's queue while a session runs or the link backs off. As many are looked at in one go.
BACKLOG = 64
# Strangers that are counted by their address; the rest are counted together.
MOST_NAMED = 16
OTHERS = "others"

_Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class TcpServer:
    """The controller calls the gateway over TCP.

    The listening socket opens with the first `connect()` and outlives sessions and back-offs, so that a call made
    meanwhile waits in the system's queue instead of being refused; `aclose()` closes it. Of several calls of the
    controller the newest is taken: it has given the older ones up. So it goes, too, when it calls again while a session
    runs, because it was started anew: the session ends by silence or keep-alive, and the next `connect()` takes the
    waiting call. Calls of strangers are closed as soon as a `connect()` sees them.

    Args:
        listen: The address of this machine to listen on, or `localhost` for 127.0.0.1; `::` takes IPv4 as well.
        port: The port to listen on; 0 lets the system choose.
        host: Address or name of the only peer that may call. A name is looked up when the socket opens, and again when
            nobody called or a stranger did.

    Attributes:
        port: The port, as bound once the socket is open.
        refused: How often strangers called, by their address; those beyond `MOST_NAMED` stand under `OTHERS`.
    """

    def __init__(self, listen: str, port: int, host: str) -> None:
        self.port = port
        self.refused: Counter[str] = Counter()
        self._listen = "127.0.0.1" if listen == "localhost" else listen
        self._host = host
        self._listener: socket.socket | None = None
        self._allowed: frozenset[_Address] = frozenset()
        self._sure = False  # whether the allowed addresses are known to be the controller's

    @property
    def peer(self) -> str:
        """The controller's address, for people."""
        return f"{self._host} (calls {self._where})"

    @property
    def notes(self) -> Sequence[str]:
        """Who called and may not."""
        return [
            f"calls from {address} were refused: only {self._host} may call ({_times(number)})"
            for address, number in self.refused.most_common()
        ]

    @property
    def rejects(self) -> Mapping[str, int]:
        """How many calls were refused."""
        return {"foreign_peer": self.refused.total()} if self.refused else {}

    async def connect(self) -> Connection:
        """Wait for the controller's call; see `Connector`."""
        if self._listener is None:
            self._listener = self._opened()
            self._sure = False
        if not self._sure:
            await self._look_up()
        call: socket.socket | None = None
        with anyio.move_on_after(CALL_TIMEOUT_S):
            call = await self._call(self._listener)
        self._sure = call is not None
        if call is None:
            raise LinkClosed(self._nobody_called(), refused=True)
        return await _connection(call)

    async def aclose(self) -> None:
        """Stop listening; calls that nobody has taken are reset."""
        listener, self._listener = self._listener, None
        if listener is not None:
            anyio.notify_closing(listener)
            listener.close()

    @property
    def _where(self) -> str:
        return address_text(self._listen, self.port)

    def _opened(self) -> socket.socket:
        """Open the listening socket."""
        try:
            everything = ipaddress.ip_address(self._listen) == ipaddress.IPv6Address("::")
            found = socket.getaddrinfo(self._listen, self.port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
            family, *_, address = found[0]
            both = everything and socket.has_dualstack_ipv6()
            listener = socket.create_server(address, family=family, backlog=BACKLOG, dualstack_ipv6=both)
        except ValueError:
            told = f'cannot listen on "{self._listen}", which is no IP address: set listen to one of this machine\'s'
            raise LinkClosed(told) from None
        except OSError as error:
            raise LinkClosed(f"cannot listen on {self._where}: {_advice(error)}") from error
        listener.settimeout(0)
        self.port = listener.getsockname()[1]
        return listener

    async def _look_up(self) -> None:
        """Find the addresses that may call; where the name service fails, those that were known stay."""
        problem: str
        try:
            with anyio.fail_after(CONNECT_TIMEOUT_S):
                self._allowed = await _addresses(self._host)
        except TimeoutError:
            problem = f"the name is not resolved within {CONNECT_TIMEOUT_S:g} s"
        except (OSError, UnicodeError) as error:  # the latter: no name at all
            problem = describe(error) if isinstance(error, OSError) else "the name cannot be resolved"
        else:
            return
        if not self._allowed:
            raise LinkClosed(f"{self._host}, which alone may call {self._where}: {problem}")

    async def _call(self, listener: socket.socket) -> socket.socket:
        """Wait for a call of the controller; nothing is awaited between taking it and returning it."""
        looked_up = False
        while True:
            try:
                await anyio.wait_readable(listener)
                await anyio.lowlevel.checkpoint_if_cancelled()  # both may have happened: then the call goes on waiting
            except anyio.ClosedResourceError:
                raise LinkClosed(f"no longer listening on {self._where}") from None
            call = self._newest(listener)
            if call is not None:
                return call
            if not looked_up:  # has the controller another address by now? Then its next call is known
                looked_up = True
                await self._look_up()

    def _newest(self, listener: socket.socket) -> socket.socket | None:
        """Take the calls that wait, and keep the controller's newest."""
        newest: socket.socket | None = None
        for _ in range(BACKLOG):
            try:
                call, address = listener.accept()
            except BlockingIOError:
                break
            except ConnectionError:  # the caller has hung up
                continue
            except OSError as error:
                if newest is None:
                    raise LinkClosed(f"cannot take calls on {self._where}: {describe(error)}") from error
                break
            caller = _canonical(address[0])
            if caller not in self._allowed:
                call.close()
                self._refuse(str(caller))
                continue
            if newest is not None:
                newest.close()
            newest = call
        return newest

    def _refuse(self, address: str) -> None:
        named = address in self.refused or len(self.refused) < MOST_NAMED
        self.refused[address if named else OTHERS] += 1

    def _nobody_called(self) -> str:
        told = (
            f"no call from {self._host} on {self._where} within {CALL_TIMEOUT_S:g} s: is it on, and is its "
            f"communication started, as a TCP client with this machine's address and port {self.port}?"
        )
        within = [address.is_loopback for address in (_canonical(self._listen), *self._allowed)]
        if within[0] and not any(within[1:]):
            told += f" Only this machine can call {self._listen}: set listen to an address that {self._host} reaches"
        return told


async def _connection(call: socket.socket) -> Connection:
    """Make a connection of a call, even while being cancelled: the call is not lost."""
    try:
        call.settimeout(0)
        prepare(call.setsockopt)
        with anyio.CancelScope(shield=True):
            stream = await SocketStream.from_socket(call)
    except (OSError, ValueError) as error:  # the latter: what anyio says of a socket that is no longer connected
        call.close()
        raise LinkClosed("the controller called and hung up at once") from error
    except BaseException:
        call.close()
        raise
    return TcpConnection(stream)


async def _addresses(host: str) -> frozenset[_Address]:
    try:
        return frozenset({_canonical(host)})
    except ValueError:
        found = await anyio.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return frozenset(_canonical(str(address[0])) for *_, address in found)


def _canonical(text: str) -> _Address:
    """An address without its zone, and in its IPv4 form where it has one."""
    address = ipaddress.ip_address(text.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def _advice(error: OSError) -> str:
    """Say what is wrong with an address or port to listen on, and what to do."""
    if error.errno == errno.EADDRINUSE:
        return "the port is in use: stop what listens there, or choose another; each robot needs its own"
    if error.errno == errno.EADDRNOTAVAIL:
        return "this machine has no such address: set listen to one of its own, or to 0.0.0.0 for all"
    if error.errno in {errno.EACCES, errno.EPERM}:
        return "ports below 1024 need privileges: choose another"
    return describe(error)
