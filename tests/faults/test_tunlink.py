from __future__ import annotations

import os
import socket
from collections import Counter

import anyio
import pytest

from tests.faults.kit import seeded
from tests.faults.tunlink import FAIR, TunLink, Weather

PACKET = bytes(range(64))
N = 2000


def shares(weather: Weather) -> tuple[list[list[tuple[float, bytes]]], Counter[str]]:
    random, counts = seeded(5), Counter[str]()
    return [weather.deliveries(PACKET, random, counts) for _ in range(N)], counts


def test_in_fair_weather_every_packet_comes_once_at_once_and_whole() -> None:
    found, counts = shares(FAIR)
    assert found == [[(0.0, PACKET)]] * N
    assert not counts


@pytest.mark.parametrize(
    ("weather", "name"),
    [
        (Weather(loss=0.1), "lost"),
        (Weather(duplicate=0.1), "duplicated"),
        (Weather(reorder=0.1, delay_s=0.2), "reordered"),
        (Weather(corrupt=0.1), "corrupted"),
    ],
)
def test_what_happens_to_a_share_of_the_packets_happens_to_that_share(weather: Weather, name: str) -> None:
    found, counts = shares(weather)
    assert 0.07 * N < counts[name] < 0.13 * N
    struck = {
        "lost": sum(not each for each in found),
        "duplicated": sum(len(each) == 2 for each in found),
        "reordered": sum(each[0][0] == 0.0 for each in found if each),
        "corrupted": sum(each[0][1] != PACKET for each in found if each),
    }
    assert struck[name] == counts[name]


def test_a_damaged_packet_has_one_wrong_bit_behind_its_headers() -> None:
    found, _ = shares(Weather(corrupt=1.0))
    for ((_, packet),) in found:
        differences = [
            (at, one ^ other) for at, (one, other) in enumerate(zip(PACKET, packet, strict=True)) if one != other
        ]
        ((at, bits),) = differences
        assert at >= 28
        assert bits.bit_count() == 1


def test_delays_lie_within_the_jitter_and_are_never_negative() -> None:
    found, _ = shares(Weather(delay_s=0.1, jitter_s=0.2))
    delays_s = [after_s for ((after_s, _),) in found]
    assert min(delays_s) == 0.0
    assert 0.25 < max(delays_s) <= 0.3


async def test_packets_are_carried_both_ways_and_none_through_a_cut() -> None:
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2)]
    for each in (one for pair in pairs for one in pair):
        each.settimeout(0)
    (one, end_one), (other, end_other) = pairs
    link = TunLink(end_one.fileno(), end_other.fileno())
    link.start()
    os.write(one.fileno(), b"there")
    os.write(other.fileno(), b"back")
    await anyio.sleep(0.05)
    assert (other.recv(99), one.recv(99)) == (b"there", b"back")
    link.weather = Weather(cut=True)
    os.write(one.fileno(), b"there")
    await anyio.sleep(0.05)
    with pytest.raises(BlockingIOError):
        other.recv(99)
    assert link.counts == {"packets": 3, "lost": 1}
    link.stop()
    for each in (one for pair in pairs for one in pair):
        each.close()
