"""TCP where the controller calls: the gateway listens and lets one peer in, but it is still the gateway that asks."""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import math
import socket
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import anyio
import anyio.lowlevel
from anyio.abc import SocketStream

from gateway.core.clock import deadline_s
from gateway.core.transport import CONNECT_TIMEOUT_S, Connection, TcpConnection, address_text, describe, prepare
from gateway.errors import LinkClosed

CALL_TIMEOUT_S = 10.0
# Calls that wait in the system's queue until the loop has its next turn, and those that it takes in one turn. Where the
# queue is full, a caller is not heard until it repeats itself, after a second.
BACKLOG = 1024
MOST_IN_A_TURN = 64
# A session that has heard nothing for so long gives way to the controller's next call.
QUIET_S = 1.0
# When no call could be taken, for want of file descriptors: the time until the next try.
RETRY_S = 1.0
# How often a name is looked up in one `connect()`.
MOST_LOOK_UPS = 2
# Strangers that are counted by their address; the rest are counted together.
MOST_NAMED = 16
OTHERS = "others"

_Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class TcpServer:
    """The controller calls the gateway over TCP.

    The listening socket opens with the first `connect()` and outlives sessions and back-offs, until `aclose()`. All the
    time between calls are taken as they come: a stranger is hung up on and counted at once, and the controller's newest
    call is held for the next `connect()`, because the controller has given up the older ones.

    A controller that calls while a session runs was started anew, as a rule, and the session's connection is half open
    and silent: its `receive()` raises when nothing has come for `QUIET_S`, and the next `connect()` gives the new call.
    While something comes, the session goes on: a controller with two clients, or one that calls without end, ends no
    session that works, and each new session has `QUIET_S` in which to be heard.

    Args:
        listen: The address of this machine to listen on, or `localhost` for 127.0.0.1; `::` takes IPv4 as well.
        port: The port to listen on; 0 lets the system choose.
        host: Address or name of the only peer that may call. A name is looked up before the first call is taken, and
            in a `connect()` after nobody called or a stranger did.

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
        self._accepting = False
        self._trouble: OSError | None = None  # why no calls can be taken
        self._retry: asyncio.TimerHandle | None = None
        self._held: socket.socket | None = None  # the controller's newest call, which nobody has taken
        self._running: _Call | None = None
        self._news: anyio.Event | None = None

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
        if not self._allowed:  # until then nobody can be told from a stranger: calls wait in the system's queue
            await self._look_up()
        self._accept(self._listener)
        call: socket.socket | None = None
        with anyio.move_on_after(CALL_TIMEOUT_S):
            call = await self._call(self._listener)
        if call is None:
            self._sure = False
            raise LinkClosed(self._nobody_called(), refused=True)
        stream = await _stream(call)
        self._running = _Call(stream, self._is_held)
        return self._running

    async def aclose(self) -> None:
        """Stop listening and hang up on a call that nobody has taken; connections stay with those who have them."""
        listener, self._listener = self._listener, None
        if listener is not None:
            self._stop_accepting(listener)
            listener.close()
        self._running = None
        self._hold(None)
        self._tell()

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
            self._sure = True
            return
        if not self._allowed:
            raise LinkClosed(f"{self._host}, which alone may call {self._where}: {problem}")

    async def _call(self, listener: socket.socket) -> socket.socket:
        """Wait for a call of the controller; nothing is awaited between taking it and returning it."""
        n_look_ups = 0
        while True:
            await anyio.lowlevel.checkpoint_if_cancelled()  # then a call that is held stays so
            call, self._held = self._held, None
            if call is not None:
                self._sure = True
                return call
            if self._listener is not listener:
                raise LinkClosed(f"no longer listening on {self._where}")
            if self._trouble is not None:
                raise LinkClosed(f"cannot take calls on {self._where}: {describe(self._trouble)}") from self._trouble
            if not self._sure and n_look_ups < MOST_LOOK_UPS:  # has the controller another address by now?
                n_look_ups += 1
                await self._look_up()
            else:
                self._news = anyio.Event()
                await self._news.wait()

    def _accept(self, listener: socket.socket) -> None:
        """Take calls from now on."""
        self._trouble = None
        if self._retry is not None:
            self._retry.cancel()
            self._retry = None
        if not self._accepting:
            asyncio.get_running_loop().add_reader(listener, self._take_calls, listener)
            self._accepting = True

    def _stop_accepting(self, listener: socket.socket) -> None:
        if self._retry is not None:
            self._retry.cancel()
            self._retry = None
        if self._accepting:
            asyncio.get_running_loop().remove_reader(listener)
            self._accepting = False

    def _take_calls(self, listener: socket.socket) -> None:
        """Take the calls that wait: the loop calls this in each turn in which there are any."""
        held = self._held
        for _ in range(MOST_IN_A_TURN):
            try:
                call, address = listener.accept()
            except BlockingIOError:
                break
            except ConnectionError:  # the caller has hung up
                continue
            except OSError as error:
                self._stop_accepting(listener)  # the calls go on waiting: the loop would call this without end
                self._trouble = error
                self._retry = asyncio.get_running_loop().call_later(RETRY_S, self._accept, listener)
                break
            caller = _canonical(address[0])
            if caller in self._allowed:
                self._hold(call)
            else:
                call.close()
                self._refuse(str(caller))
                self._sure = False
        if self._held is not held and self._running is not None:
            self._running.called_again()
        self._tell()

    def _hold(self, call: socket.socket | None) -> None:
        if self._held is not None:
            self._held.close()
        self._held = call

    def _is_held(self) -> bool:
        """Whether a call of the controller waits; one that was hung up with nothing said is forgotten."""
        if self._held is None:
            return False
        try:
            alive = bool(self._held.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT))
        except BlockingIOError:
            alive = True
        except OSError:
            alive = False
        if not alive:
            self._hold(None)
        return alive

    def _tell(self) -> None:
        """Let a `connect()` that waits look again."""
        if self._news is not None:
            self._news.set()

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


class _Call(TcpConnection):
    """A call of the controller that was taken; it gives way to the next one when nothing comes any more.

    Args:
        stream: The call.
        is_held: Whether another call of the controller waits.
    """

    def __init__(self, stream: SocketStream, is_held: Callable[[], bool]) -> None:
        super().__init__(stream)
        self._is_held = is_held
        self._contested = is_held()
        self._heard_s = anyio.current_time()
        self._silence = anyio.CancelScope()

    def called_again(self) -> None:
        """Take that another call of the controller waits."""
        self._contested = True
        self._silence.deadline = self._deadline_s()

    async def receive(self) -> bytes:
        """Wait for bytes; see `Pulled`."""
        while True:
            with anyio.CancelScope(deadline=self._deadline_s()) as self._silence:
                data = await super().receive()
                self._heard_s = anyio.current_time()
                return data
            self._contested = self._is_held()
            if self._contested:
                raise LinkClosed("the controller has called again")

    def _deadline_s(self) -> float:
        return deadline_s(self._heard_s + QUIET_S) if self._contested else math.inf


async def _stream(call: socket.socket) -> SocketStream:
    """Make a stream of a call, even while being cancelled: the call is not lost."""
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
    return stream


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
