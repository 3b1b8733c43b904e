"""Network captures: every connection's bytes in their order and once, whatever the network did to the segments."""

from __future__ import annotations

import random
from pathlib import Path

import dpkt
import pytest

from gateway.record.captures import Capture
from gateway.record.pieces import Conversation, FileError
from tests.record.kit import QUESTION, known_frames
from tests.record.wire import CONTROLLER, GATEWAY, Packet, datagram, ethernet, packet, pcap, pcapng, segment, session

FRAMES = known_frames()
RECEIVED = b"".join(FRAMES)


def capture(path: Path, port: int | None = 5000, host: str | None = None) -> Capture:
    return Capture(path, frozenset() if port is None else frozenset({port}), frozenset({host} if host else ()))


def capture_if_any(path: Path) -> Capture | None:
    """The same; None where it says in words that nothing can be read."""
    try:
        return capture(path)
    except FileError:
        return None


def joined(conversation: Conversation, kind: str = "received") -> bytes:
    return b"".join(piece.data for piece in conversation.pieces if piece.kind == kind)


def the_only(found: Capture) -> Conversation:
    assert len(found.conversations) == 1
    return found.conversations[0]


@pytest.mark.parametrize("write", [pcap, pcapng])
def test_a_connection_is_read_in_both_formats(write: object, tmp_path: Path) -> None:
    path = tmp_path / "net.pcap"
    assert callable(write)
    write(path, session(FRAMES, QUESTION))

    found = the_only(capture(path))

    assert found.name == "192.168.58.10:40000 - 192.168.58.2:5000"
    assert joined(found) == RECEIVED
    assert joined(found, "sent") == QUESTION * len(FRAMES)
    kinds = [piece.kind for piece in found.pieces]
    assert kinds == ["begin", *["sent", "received", "received"] * len(FRAMES), "end"]
    assert found.notes == []


@pytest.mark.parametrize("seed", range(5))
def test_segments_out_of_order_and_sent_again_give_each_byte_once(seed: int, tmp_path: Path) -> None:
    dice = random.Random(seed)  # noqa: S311 - nothing secret
    at, parts = 0, []
    while at < len(RECEIVED):
        size = dice.randrange(1, 200)
        parts.append((at, RECEIVED[at : at + size]))
        at += dice.randrange(1, size + 1)  # the next one may hold some of it again
    parts += dice.choices(parts, k=20)
    ahead = sorted(parts, key=lambda part: part[0] + dice.randrange(600))
    isn = (1 << 32) - 700  # the numbers wrap
    opens = segment(CONTROLLER, GATEWAY, isn - 1, flags=dpkt.tcp.TH_SYN | dpkt.tcp.TH_ACK)
    path = pcap(tmp_path / "net.pcap", [opens, *(segment(CONTROLLER, GATEWAY, isn + at, data) for at, data in ahead)])

    found = the_only(capture(path))

    assert joined(found) == RECEIVED
    assert "sent more than once" in found.notes[0]


def test_bytes_that_were_not_captured_are_said_and_cut_the_stream(tmp_path: Path) -> None:
    packets = session(FRAMES, QUESTION)
    del packets[7]  # the first half of the second frame

    found = the_only(capture(pcap(tmp_path / "net.pcap", packets)))

    assert joined(found) == FRAMES[0] + FRAMES[1][290:] + FRAMES[2] + FRAMES[3]
    assert [piece.kind for piece in found.pieces].count("missing") == 1
    assert found.notes == ["290 bytes that the controller sent are missing in the capture"]


def test_bytes_that_never_come_hold_nothing_up_for_ever(tmp_path: Path) -> None:
    packets = [segment(CONTROLLER, GATEWAY, 100, b"a"), segment(CONTROLLER, GATEWAY, 200, b"b" * 50)]

    found = the_only(capture(pcap(tmp_path / "net.pcap", packets)))

    assert joined(found) == b"a" + b"b" * 50
    assert found.notes == ["99 bytes that the controller sent are missing in the capture"]


def test_a_new_connection_between_the_same_ends_is_another_one(tmp_path: Path) -> None:
    packets = [*session(FRAMES[:1], QUESTION), *session(FRAMES[1:2], QUESTION, isn=500_000)]

    found = capture(pcap(tmp_path / "net.pcap", packets)).conversations

    assert [joined(one) for one in found] == [FRAMES[0], FRAMES[1]]


def test_an_opening_that_is_sent_again_is_no_new_connection(tmp_path: Path) -> None:
    packets = session(FRAMES[:1], QUESTION)

    assert joined(the_only(capture(pcap(tmp_path / "net.pcap", [packets[0], *packets])))) == FRAMES[0]


def test_only_the_connections_with_the_controller_are_read(tmp_path: Path) -> None:
    other = ("192.168.58.3", 5000)
    web = segment(GATEWAY, ("10.0.0.1", 443), 1, b"hello")
    packets = [*session(FRAMES[:1], QUESTION), web, segment(other, GATEWAY, 1, b"x")]
    path = pcap(tmp_path / "net.pcap", packets)

    assert [one.name for one in capture(path).conversations] == [
        "192.168.58.10:40000 - 192.168.58.2:5000",
        "192.168.58.10:40000 - 192.168.58.3:5000",
    ]
    assert the_only(capture(path, host="192.168.58.2")).name.endswith("58.2:5000")
    assert the_only(capture(path, None, "192.168.58.3")).name.endswith("58.3:5000")
    nothing = capture(path, 9999)
    assert nothing.conversations == []
    assert "TCP 10.0.0.1:443 - 192.168.58.10:40000" in nothing.others_listed


def test_datagrams_stay_whole(tmp_path: Path) -> None:
    packets = [datagram(GATEWAY, CONTROLLER, b"ask"), *(datagram(CONTROLLER, GATEWAY, frame) for frame in FRAMES)]

    found = the_only(capture(pcap(tmp_path / "net.pcap", packets)))

    assert found.datagrams
    assert [piece.data for piece in found.pieces if piece.kind == "received"] == list(FRAMES)


@pytest.mark.parametrize(
    ("link", "around"),
    [
        (dpkt.pcap.DLT_NULL, lambda inner: b"\x02\x00\x00\x00" + bytes(inner)),
        (101, bytes),
        (dpkt.pcap.DLT_LINUX_SLL, lambda inner: bytes(14) + b"\x08\x00" + bytes(inner)),
        (276, lambda inner: b"\x08\x00" + bytes(18) + bytes(inner)),
        (dpkt.pcap.DLT_EN10MB, lambda inner: ethernet(inner, vlan=7)),
        (dpkt.pcap.DLT_EN10MB, lambda inner: ethernet(inner) + bytes(20)),  # filled up by the network card
    ],
    ids=["loopback", "raw", "cooked", "cooked2", "vlan", "padded"],
)
def test_packets_are_found_in_what_carries_them(link: int, around: object, tmp_path: Path) -> None:
    assert callable(around)
    packets = [around(inner) for inner in session(FRAMES[:2], QUESTION)]

    assert joined(the_only(capture(pcap(tmp_path / "net.pcap", packets, link)))) == FRAMES[0] + FRAMES[1]


def test_ip6_is_read(tmp_path: Path) -> None:
    source, target = ("fd00::2", 5000), ("fd00::10", 40000)

    found = the_only(capture(pcap(tmp_path / "net.pcap", [segment(source, target, 1, FRAMES[0])])))

    assert found.name == "[fd00::10]:40000 - [fd00::2]:5000"
    assert joined(found) == FRAMES[0]


def test_a_capture_that_is_cut_off_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = pcap(tmp_path / "net.pcap", session(FRAMES, QUESTION))
    whole = path.read_bytes()
    longest = b""
    for size in range(24, len(whole), 13):
        path.write_bytes(whole[:size])
        found = capture_if_any(path)
        if found is None:
            continue
        received = joined(found.conversations[0]) if found.conversations else b""
        assert RECEIVED.startswith(received)
        longest = max(longest, received, key=len)
    assert len(longest) > len(RECEIVED) - 100


@pytest.mark.parametrize("write", [pcap, pcapng])
def test_a_capture_with_a_damaged_byte_is_no_crash(write: object, tmp_path: Path) -> None:
    path = tmp_path / "net.pcap"
    assert callable(write)
    write(path, session(FRAMES[:2], QUESTION))
    whole = path.read_bytes()
    for at in range(0, len(whole), 11):
        damaged = bytearray(whole)
        damaged[at] ^= 0xA5
        path.write_bytes(damaged)
        capture_if_any(path)


def test_what_cannot_be_read_is_said_in_words(tmp_path: Path) -> None:
    path = tmp_path / "net.pcap"
    path.write_bytes(b"this is text")
    with pytest.raises(FileError, match="is no capture that can be read"):
        capture(path)
    with pytest.raises(FileError, match="is a capture without packets"):
        capture(pcap(path, []))
    with pytest.raises(FileError, match="holds packets of link type 147"):
        capture(pcap(path, [b"x"], 147))
    with pytest.raises(FileError, match="cannot be read: No such file"):
        capture(tmp_path / "none.pcap")


def test_fragments_and_odd_packets_are_counted(tmp_path: Path) -> None:
    fragment: Packet = packet(CONTROLLER, GATEWAY, dpkt.udp.UDP(sport=5000, dport=1, data=b"x", ulen=9), 17)
    fragment.mf = 1
    odd = ethernet(segment(CONTROLLER, GATEWAY, 1, b"x"))[:20]

    found = capture(pcap(tmp_path / "net.pcap", [fragment, odd]))

    assert found.notes[0] == "1 fragments of IP packets are left out"
