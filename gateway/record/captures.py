"""Network captures, pcap and pcapng: the conversations with controllers in them, each TCP stream put together again."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from struct import error as StructError  # noqa: N812 - it is an exception
from typing import Literal

import dpkt

from gateway.record.pieces import Conversation, FileError, Piece

_DAMAGE = (dpkt.Error, ValueError, IndexError, KeyError, AttributeError, OverflowError, MemoryError, StructError)
_LOOPBACK = {dpkt.pcap.DLT_NULL, dpkt.pcap.DLT_LOOP}
_RAW = {dpkt.pcap.DLT_RAW, 12, 101, 228, 229}
_COOKED, _COOKED_2, _ETHERNET = dpkt.pcap.DLT_LINUX_SLL, 276, dpkt.pcap.DLT_EN10MB
_KNOWN = {_ETHERNET, _COOKED, _COOKED_2, *_LOOPBACK, *_RAW}
_WRAP = 1 << 32
_HALF = 1 << 31
# So much may wait for bytes that come out of order, before these count as not captured.
_MOST_WAITING = 1 << 20
_LISTED = 8

Carrier = Literal["TCP", "UDP"]


@dataclass(frozen=True, slots=True)
class Address:
    """One end of a connection."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(slots=True)
class _Way:
    """One direction of a TCP connection: segments put in the order of their bytes, each byte once."""

    expected: int | None = None
    waiting: dict[int, bytes] = field(default_factory=dict)  # by sequence number
    n_repeated: int = 0

    def take(self, seq: int, data: bytes) -> Iterator[bytes]:
        """Take a segment; the bytes that are complete with it."""
        if self.expected is None:
            self.expected = seq
        if len(data) > len(self.waiting.get(seq, b"")):
            self.waiting[seq] = data
        yield from self._ready()

    def missing(self, *, all_: bool = False) -> int:
        """Give up what does not come, if too much waits for it; how many bytes that are."""
        if not self.waiting or self.expected is None:
            return 0
        if not all_ and sum(map(len, self.waiting.values())) <= _MOST_WAITING:
            return 0
        gap = min((seq - self.expected) % _WRAP for seq in self.waiting)
        self.expected = (self.expected + gap) % _WRAP
        return gap

    def ready(self) -> Iterator[bytes]:
        """The bytes that are complete now."""
        yield from self._ready()

    def told(self, ack: int) -> bool:
        """Whether the other side has bytes, by what it acknowledges, that are waited for here in vain."""
        return bool(self.waiting) and self._ahead(ack) > 0

    def _ahead(self, seq: int) -> int:
        """How many bytes a sequence number is ahead of the one that is expected; negative: behind it."""
        return (seq - (self.expected or 0) + _HALF) % _WRAP - _HALF

    def _ready(self) -> Iterator[bytes]:
        moved = True
        while moved and self.expected is not None:
            moved = False
            for seq in sorted(self.waiting, key=self._ahead):
                ahead = self._ahead(seq)
                if ahead > 0:
                    break
                data = self.waiting.pop(seq)
                new = data[-ahead:] if ahead else data
                self.n_repeated += len(data) - len(new)
                if new:
                    self.expected = (self.expected + len(new)) % _WRAP
                    moved = True
                    yield new
                    break


@dataclass(slots=True)
class _Connection:
    """A connection, or the datagrams between two addresses."""

    carrier: Carrier
    controller: Address
    client: Address
    conversation: Conversation
    pieces: list[Piece]
    ways: dict[bool, _Way] = field(default_factory=lambda: {True: _Way(), False: _Way()})  # by: from the controller

    def segment(self, t: int, seq: int, data: bytes, *, received: bool) -> None:
        way = self.ways[received]
        for ready in way.take(seq, data):
            self._put(received, ready, t)
        self._give_up(t, received=received, all_=False)

    def acknowledged(self, t: int, ack: int, *, received: bool) -> None:
        """One side says what it has of the other's bytes: those that are not here by now were not captured."""
        while self.ways[received].told(ack):
            self._give_up(t, received=received, all_=True)

    def end(self) -> None:
        """Nothing more comes."""
        pieces = self.pieces
        t = pieces[-1].t or 0
        for received in (False, True):
            while self.ways[received].waiting:
                self._give_up(t, received=received, all_=True)
        pieces.append(Piece("end", t=t))
        repeated = sum(way.n_repeated for way in self.ways.values())
        if repeated:
            self.conversation.notes.append(f"{repeated} bytes were sent more than once, and are read once")

    def _give_up(self, t: int, *, received: bool, all_: bool) -> None:
        way = self.ways[received]
        gap = way.missing(all_=all_)
        if gap:
            whose = "the controller" if received else "its client"
            self.conversation.notes.append(f"{gap} bytes that {whose} sent are missing in the capture")
            if received:
                self.pieces.append(Piece("missing", t=t))
        for ready in way.ready():
            self._put(received, ready, t)

    def _put(self, received: bool, data: bytes, t: int) -> None:  # noqa: FBT001 - which way it went
        self.pieces.append(Piece("received" if received else "sent", data, t))


class Capture:
    """Reads a capture.

    Args:
        path: The file.
        ports: Ports of the controllers.
        hosts: Addresses of the controllers; empty: any.

    Attributes:
        conversations: With the controllers, in the order in which they begin.
        notes: What should be known of the file, one sentence each.
        others: Connections that are none of theirs, with how many packets.
    """

    def __init__(self, path: Path, ports: frozenset[int], hosts: frozenset[str]) -> None:
        self._path = path
        self._ports = ports
        self._hosts = hosts
        self._open: dict[tuple[Carrier, Address, Address], _Connection] = {}
        self.conversations: list[Conversation] = []
        self.notes: list[str] = []
        self.others: dict[str, int] = {}
        self._n_fragments = self._n_unread = 0
        self._read()

    @property
    def others_listed(self) -> str:
        """Some of the connections that are none of theirs, in words."""
        names = sorted(self.others, key=lambda name: -self.others[name])
        more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        return ", ".join(names[:_LISTED]) + more

    def _read(self) -> None:
        n_packets = 0
        try:
            with self._path.open("rb") as file:
                reader = dpkt.pcap.UniversalReader(file)
                link = reader.datalink()
                if link not in _KNOWN:
                    raise FileError(self._path, f"holds packets of link type {link}, which this gateway cannot read")
                for t, data in reader:
                    n_packets += 1
                    self._packet(round(float(t) * 1e6), link, data)
        except _DAMAGE as error:
            if not n_packets:
                raise FileError(self._path, f"is no capture that can be read: {error}") from None
            self.notes.append(f"it is cut off or damaged after {n_packets} packets; what comes before is read")
        except OSError as error:
            raise FileError(self._path, f"cannot be read: {error.strerror}") from None
        if not n_packets:
            raise FileError(self._path, "is a capture without packets")
        for connection in self._open.values():
            connection.end()
        if self._n_fragments:
            self.notes.append(f"{self._n_fragments} fragments of IP packets are left out")
        if self._n_unread:
            self.notes.append(f"{self._n_unread} packets cannot be read")

    def _packet(self, t: int, link: int, data: bytes) -> None:
        try:
            packet = _ip_of(link, data)
            if packet is None:
                return
            if _is_fragment(packet):
                self._n_fragments += 1
                return
            carried = packet.data
            if isinstance(carried, dpkt.tcp.TCP):
                self._segment(t, packet, carried)
            elif isinstance(carried, dpkt.udp.UDP):
                self._datagram(t, packet, carried)
        except _DAMAGE:
            self._n_unread += 1

    def _segment(self, t: int, packet: dpkt.ip.IP, segment: dpkt.tcp.TCP) -> None:
        opens = bool(segment.flags & dpkt.tcp.TH_SYN)
        found = self._connection("TCP", packet, segment, t, opens=opens)
        if found is None:
            return
        connection, received = found
        data = bytes(segment.data)
        if segment.flags & dpkt.tcp.TH_ACK:
            connection.acknowledged(t, segment.ack, received=not received)
        if opens:
            connection.ways[received].expected = (segment.seq + 1) % _WRAP
        elif data:
            connection.segment(t, segment.seq, data, received=received)

    def _datagram(self, t: int, packet: dpkt.ip.IP, datagram: dpkt.udp.UDP) -> None:
        found = self._connection("UDP", packet, datagram, t, opens=False)
        if found is None:
            return
        connection, received = found
        connection.pieces.append(Piece("received" if received else "sent", bytes(datagram.data), t))

    def _connection(
        self, carrier: Carrier, packet: dpkt.ip.IP, carried: dpkt.tcp.TCP | dpkt.udp.UDP, t: int, *, opens: bool
    ) -> tuple[_Connection, bool] | None:
        """The connection that a packet belongs to, and whether the controller sent it; None: it is none of theirs."""
        source = Address(str(ipaddress.ip_address(packet.src)), carried.sport)
        target = Address(str(ipaddress.ip_address(packet.dst)), carried.dport)
        if self._is_controller(source):
            controller, client, received = source, target, True
        elif self._is_controller(target):
            controller, client, received = target, source, False
        else:
            name = f"{carrier} {min(source, target, key=str)} - {max(source, target, key=str)}"
            self.others[name] = self.others.get(name, 0) + 1
            return None
        key = (carrier, controller, client)
        found = self._open.get(key)
        if found is not None and opens and found.ways[received].expected not in {None, (carried.seq + 1) % _WRAP}:
            found.end()  # the same two ends, a new connection
            found = None
        if found is None:
            pieces = [Piece("begin", t=t)]
            conversation = Conversation(f"{client} - {controller}", pieces, carrier == "UDP")
            self.conversations.append(conversation)
            found = self._open[key] = _Connection(carrier, controller, client, conversation, pieces)
        return found, received

    def _is_controller(self, address: Address) -> bool:
        return (not self._hosts or address.host in self._hosts) and (not self._ports or address.port in self._ports)


def _ip_of(link: int, data: bytes) -> dpkt.ip.IP | dpkt.ip6.IP6 | None:
    """The IP packet in a captured one; None: it holds none."""
    if link == _ETHERNET:
        found = dpkt.ethernet.Ethernet(data).data
    elif link == _COOKED:
        found = dpkt.sll.SLL(data).data
    elif link == _COOKED_2:
        found = dpkt.sll2.SLL2(data).data
    elif link in _LOOPBACK:
        found = _bare(data[4:])
    elif link in _RAW:
        found = _bare(data)
    else:
        raise ValueError(f"packets of link type {link} are not known")
    return found if isinstance(found, (dpkt.ip.IP, dpkt.ip6.IP6)) else None


def _bare(data: bytes) -> dpkt.ip.IP | dpkt.ip6.IP6:
    return dpkt.ip6.IP6(data) if data[0] >> 4 == 6 else dpkt.ip.IP(data)  # noqa: PLR2004 - the version of IP


def _is_fragment(packet: dpkt.ip.IP | dpkt.ip6.IP6) -> bool:
    return isinstance(packet, dpkt.ip.IP) and bool(packet.mf or packet.offset)
