"""How much one peer address may ask of the doors, and how many connections there may be in all.

Nothing here waits and nothing is read from a socket: the listener, the handshake, the reader of a WebSocket and the
subscriptions ask here. A proxy is one address, whoever is behind it; of an IPv6 address its network of 64 bits counts.
"""

from __future__ import annotations

import ipaddress
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import MappingProxyType

from aiohttp import web

from gateway.server.refusals import Refusals
from gateway.server.settings import Limits

# Reasons of refusals, and what the log says.
WORDS = MappingProxyType(
    {
        "connections": "it has as many connections as one address may have: server.limits.connections",
        "all_connections": "all clients together have as many connections as the process has files for: LimitNOFILE",
        "handshakes": "it sends requests faster than server.limits.handshakes_per_s",
        "messages": "it sends messages faster than server.limits.messages_per_s: they are read later",
        "subscriptions": "it has as many subscriptions as one address may have: server.limits.subscriptions",
    }
)
IDLE = "idle"  # only counted: browsers open connections that they may never use
# What may be asked at once after a rest: so many seconds' worth.
BURST_S = 5.0
# File descriptors that connections to the doors never take: the robots' links need two each, logs and files the rest.
RESERVED = 64
RESERVED_PER_ROBOT = 2
_LEAST_OPEN = 16
# So many peers without a connection are remembered.
_REMEMBERED = 1024
# Of all connections one peer leaves this share to the others.
_OTHERS_SHARE = 8
_IPV6_NETWORK = 64
_EXACT_S = 1e-6  # sums of fractions of a second are not exact


def name_of(address: str | None) -> str:
    """What a peer is counted as: its IPv4 address, the /64 of its IPv6 address, or nothing where it has none."""
    if not address or ":" not in address:
        return address or ""
    try:
        parsed = ipaddress.IPv6Address(address.split("%", 1)[0])
    except ValueError:
        return address
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(ipaddress.ip_network((parsed, _IPV6_NETWORK), strict=False)) if not parsed.is_loopback else str(parsed)


@dataclass(slots=True)
class Bucket:
    """What a peer may still do at once; the rate may change at any time.

    Attributes:
        rested_s: Monotonic time when, at the rate, all that was taken is made good.
    """

    rested_s: float = 0.0

    def wait_s(self, rate: float, now_s: float) -> float:
        """How long to wait until one more may be taken, in s; 0: at once."""
        wait_s = self.rested_s - now_s + 1 / rate - max(BURST_S, 1 / rate)
        return wait_s if wait_s > _EXACT_S else 0.0

    def take(self, rate: float, now_s: float) -> None:
        """Take one, whether it is there or not: who takes too much waits longer the next time."""
        self.rested_s = max(self.rested_s, now_s) + 1 / rate


@dataclass(slots=True)
class Peer:
    """One address and what it has at present.

    Attributes:
        name: As it is counted, and shown in the log.
        connections: Open sockets.
        subscriptions: Over all its connections.
        handshakes: Its requests over HTTP.
        messages: What it says on its WebSockets.
    """

    name: str
    connections: int = 0
    subscriptions: int = 0
    handshakes: Bucket = field(default_factory=Bucket)
    messages: Bucket = field(default_factory=Bucket)


class Peers:
    """Every peer that is here, or was a short while ago.

    Args:
        limits: What one of them may have.
        refusals: Where it is counted what they did not get.
        robots: How many robots there are: their links are reserved descriptors.
        now: The monotonic clock, in s.
        descriptors: How many files the process may have open.

    Attributes:
        limits: What one of them may have now.
        n_open: Open sockets of all peers.
    """

    def __init__(
        self,
        limits: Limits,
        refusals: Refusals,
        robots: Callable[[], int] = lambda: 0,
        now: Callable[[], float] = time.monotonic,
        descriptors: Callable[[], int] = lambda: resource.getrlimit(resource.RLIMIT_NOFILE)[0],
    ) -> None:
        self.limits = limits
        self.refusals = refusals
        self.n_open = 0
        self.now = now
        self._robots = robots
        self._descriptors = descriptors
        self._here: dict[str, Peer] = {}
        self._gone: dict[str, Peer] = {}  # the one that was used last stands last

    @property
    def most_open(self) -> int:
        """How many sockets all peers together may have open."""
        descriptors = self._descriptors()
        if descriptors < 0 or descriptors == resource.RLIM_INFINITY:
            descriptors = 1 << 20
        return max(_LEAST_OPEN, descriptors - RESERVED - RESERVED_PER_ROBOT * self._robots())

    def replace(self, limits: Limits) -> None:
        """Hold the peers to other limits from now on; what they have already, they keep."""
        self.limits = limits

    def admit(self, address: str | None) -> Lease | None:
        """Let a new connection in; None: it must be closed."""
        name, most = name_of(address), self.most_open
        if self.n_open >= most:
            self.refuse("all_connections", name)
            return None
        peer = self.of(address)
        if peer.connections >= min(self.limits.connections, most - most // _OTHERS_SHARE):
            self.refuse("connections", name)
            return None
        return Lease(self, peer)

    def of(self, address: str | None) -> Peer:
        """What is known of a peer."""
        name = name_of(address)
        found = self._here.get(name)
        if found is None:
            found = self._gone.pop(name, None) or Peer(name)
            self._remember(found)
        return found

    def handshake_wait_s(self, address: str | None) -> float:
        """Take one handshake; how long to wait before the next try if there is none left, else 0."""
        peer = self.of(address)
        rate, now_s = self.limits.handshakes_per_s, self.now()
        wait_s = peer.handshakes.wait_s(rate, now_s)
        if wait_s > 0:
            self.refuse("handshakes", peer.name)
        else:
            peer.handshakes.take(rate, now_s)
        return wait_s

    def refuse(self, reason: str, peer: str) -> None:
        """Count a refusal, and log it where the peer was not refused the same within the last minute."""
        self.refusals.add(reason, peer, WORDS[reason])

    def enter(self, peer: Peer) -> None:
        """Count a connection."""
        self._gone.pop(peer.name, None)
        self._here[peer.name] = peer
        peer.connections += 1
        self.n_open += 1

    def leave(self, peer: Peer) -> None:
        """Count it no longer."""
        peer.connections -= 1
        self.n_open -= 1
        if not peer.connections:
            del self._here[peer.name]
            self._remember(peer)

    def _remember(self, peer: Peer) -> None:
        self._gone[peer.name] = peer
        if len(self._gone) > _REMEMBERED:
            del self._gone[next(iter(self._gone))]


class Lease:
    """One open socket of a peer: it counts until it is released."""

    __slots__ = ("_held", "_peers", "peer")

    def __init__(self, peers: Peers, peer: Peer) -> None:
        self._peers = peers
        self.peer = peer
        self._held = True
        peers.enter(peer)

    def release(self) -> None:
        """Count the socket no longer; a second time does nothing."""
        if self._held:
            self._held = False
            self._peers.leave(self.peer)

    def idle(self) -> None:
        """Count that the socket is closed because nothing came over it."""
        self._peers.refusals.counts[IDLE] += 1


class Quota:
    """What one connection takes of its peer's share: its subscriptions, and the pace of its messages.

    Args:
        peers: Where it is counted.
        address: Of the peer.
    """

    def __init__(self, peers: Peers, address: str | None) -> None:
        self._peers = peers
        self._peer = peers.of(address)
        self._taken = 0
        self._slowed = False

    @property
    def words(self) -> str:
        """What there is to say about a subscription that was not to be had."""
        most = self._peers.limits.subscriptions
        return f"one address has at most {most} subscriptions over all its connections (server.limits.subscriptions)"

    def take(self) -> bool:
        """Take one subscription; whether it is there to be had."""
        if self._peer.subscriptions >= self._peers.limits.subscriptions:
            self._peers.refuse("subscriptions", self._peer.name)
            return False
        self._peer.subscriptions += 1
        self._taken += 1
        return True

    def give(self) -> None:
        """Give one back."""
        self._peer.subscriptions -= 1
        self._taken -= 1

    def close(self) -> None:
        """Give back what is still taken."""
        self._peer.subscriptions -= self._taken
        self._taken = 0

    def message_wait_s(self) -> float:
        """Count one message that was read; how long to wait before the next one is, in s."""
        messages, rate, now_s = self._peer.messages, self._peers.limits.messages_per_s, self._peers.now()
        messages.take(rate, now_s)
        wait_s = messages.wait_s(rate, now_s)
        if wait_s > 0 and not self._slowed:
            self._slowed = True
            self._peers.refuse("messages", self._peer.name)
        return wait_s


PEERS = web.AppKey("peers", Peers)
