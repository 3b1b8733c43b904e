"""Makes network captures for tests: TCP segments and UDP datagrams between a gateway and a controller."""

from __future__ import annotations

import ipaddress
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import dpkt

from tests.record.kit import T0

GATEWAY, CONTROLLER = ("192.168.58.10", 40000), ("192.168.58.2", 5000)
End = tuple[str, int]
Packet: TypeAlias = Any  # dpkt has no types


def segment(
    source: End, target: End, seq: int, data: bytes = b"", *, flags: int = dpkt.tcp.TH_ACK, ack: int = 0
) -> Packet:
    """An IP packet with a TCP segment."""
    carried = dpkt.tcp.TCP(sport=source[1], dport=target[1], seq=seq % (1 << 32), ack=ack, flags=flags, data=data)
    return packet(source, target, carried, dpkt.ip.IP_PROTO_TCP)


def datagram(source: End, target: End, data: bytes) -> Packet:
    """An IP packet with a UDP datagram."""
    carried = dpkt.udp.UDP(sport=source[1], dport=target[1], data=data, ulen=len(data) + 8)
    return packet(source, target, carried, dpkt.ip.IP_PROTO_UDP)


def packet(source: End, target: End, carried: Packet, number: int) -> Packet:
    """An IP packet."""
    ends = (ipaddress.ip_address(source[0]).packed, ipaddress.ip_address(target[0]).packed)
    if len(ends[0]) == 16:
        return dpkt.ip6.IP6(src=ends[0], dst=ends[1], nxt=number, plen=len(carried), hlim=64, data=carried)
    found = dpkt.ip.IP(src=ends[0], dst=ends[1], p=number, data=carried)
    found.len = len(found)
    return found


def ethernet(inner: Packet, vlan: int | None = None) -> bytes:
    """A frame of the network."""
    kind = dpkt.ethernet.ETH_TYPE_IP6 if isinstance(inner, dpkt.ip6.IP6) else dpkt.ethernet.ETH_TYPE_IP
    tag = b"" if vlan is None else struct.pack(">HH", 0x8100, vlan)
    return bytes(12) + tag + struct.pack(">H", kind) + bytes(inner)


def pcap(path: Path, packets: Sequence[Packet | bytes], link: int = dpkt.pcap.DLT_EN10MB) -> Path:
    """A capture, a millisecond between packets."""
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file, linktype=link)
        for number, one in enumerate(packets):
            writer.writepkt(one if isinstance(one, bytes) else ethernet(one), ts=T0 / 1e6 + number / 1000)
    return path


def pcapng(path: Path, packets: Sequence[Packet]) -> Path:
    """The same in the newer format."""
    with path.open("wb") as file:
        writer = dpkt.pcapng.Writer(file)
        for number, one in enumerate(packets):
            writer.writepkt(ethernet(one), ts=T0 / 1e6 + number / 1000)
    return path


def session(frames: Sequence[bytes], question: bytes, isn: int = 1000) -> list[Packet]:
    """A whole connection: opened, asked and answered, closed."""
    asked, answered = isn + 1, 77_001
    packets = [
        segment(GATEWAY, CONTROLLER, isn, flags=dpkt.tcp.TH_SYN),
        segment(CONTROLLER, GATEWAY, 77_000, flags=dpkt.tcp.TH_SYN | dpkt.tcp.TH_ACK, ack=isn + 1),
        segment(GATEWAY, CONTROLLER, asked, ack=answered),
    ]
    for frame in frames:
        packets.append(segment(GATEWAY, CONTROLLER, asked, question, ack=answered))
        asked += len(question)
        half = len(frame) // 2
        packets.append(segment(CONTROLLER, GATEWAY, answered, frame[:half], ack=asked))
        packets.append(segment(CONTROLLER, GATEWAY, answered + half, frame[half:], ack=asked))
        answered += len(frame)
    return [*packets, segment(CONTROLLER, GATEWAY, answered, flags=dpkt.tcp.TH_FIN | dpkt.tcp.TH_ACK, ack=asked)]
