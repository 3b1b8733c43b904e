from __future__ import annotations

import dataclasses
import struct
from datetime import UTC, datetime
from zoneinfo import ZoneInfo

import anyio
import pytest

from gateway.api.decoder import Frame
from gateway.api.layout import Field, Layout
from gateway.api.model import LinkStats
from gateway.api.vendor import WallClock
from gateway.core.bus import Bus
from gateway.core.controller_clock import ControllerClock
from gateway.core.events import EventRing
from gateway.core.link import Link
from tests.core import toy
from tests.core.fakes import EPOCH_US, FakeConnection, FakeConnector, LoopClock, run_jumping

LAYOUT = Layout(
    name="clocked",
    size=18,
    source="invented",
    fields=(
        Field(name="date", offset=4, type="u16", count=3),
        Field(name="ms", offset=10, type="u16"),
        Field(name="time", offset=12, type="u16", count=3),
    ),
)


def read(*parts: int) -> tuple[int, int, int, int, int, int, int]:
    year, month, day, hour, minute, second, ms = parts
    return year, month, day, hour, minute, second, ms * 1000


WALL_CLOCK = WallClock(fields=("date", "time", "ms"), read=read)


def frame(year: int = 2026) -> Frame:
    return Frame(b"head" + struct.pack("<7H", year, 5, 17, 250, 12, 34, 56), LAYOUT)


def us(*parts: int) -> int:
    return int(datetime(*parts, tzinfo=UTC).timestamp()) * 1_000_000  # type: ignore[misc,arg-type] # six numbers


def test_the_clock_is_read_in_its_zone() -> None:
    assert ControllerClock(WALL_CLOCK, None).utc_us(frame()) == us(2026, 5, 17, 12, 34, 56) + 250_000
    seoul = ControllerClock(WALL_CLOCK, ZoneInfo("Asia/Seoul"))
    assert seoul.zone_is_known
    assert seoul.utc_us(frame()) == us(2026, 5, 17, 3, 34, 56) + 250_000


def test_a_clock_that_was_never_set_tells_nothing() -> None:
    assert ControllerClock(WALL_CLOCK, None).utc_us(frame(year=0)) is None


def test_a_frame_that_does_not_carry_the_clock_tells_nothing() -> None:
    short = LAYOUT.prefix(14, name="short")
    assert ControllerClock(WALL_CLOCK, None).utc_us(Frame(frame().raw[:14], short)) is None


@pytest.mark.parametrize("zone", [None, ZoneInfo("Asia/Seoul")])
def test_samples_carry_the_controllers_time_once_its_zone_is_known(zone: ZoneInfo | None) -> None:
    wall_clock = WallClock(fields=("run_time",), read=lambda s: (2023, 11, 14, 22, 13, int(s), 0))
    settings = toy.settings(pushed=True)
    protocol = dataclasses.replace(settings.protocol, wall_clock=wall_clock)
    settings = dataclasses.replace(settings, protocol=protocol, clock_zone=zone)
    bus = Bus(EventRing(10))

    async def main() -> None:
        connection = FakeConnection()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(Link(settings, FakeConnector(connection), bus, LoopClock()).run)
            await anyio.sleep(0.5)
            connection.push(toy.frame(run_time=20.0))
            await anyio.sleep(0.7)
            tasks.cancel_scope.cancel()

    run_jumping(main)
    joints, stats = bus.topics["r1/joints"], bus.topics["r1/link_stats"]
    assert joints.latest is not None
    assert stats.latest is not None
    sample = joints.latest.sample(joints)
    told = us(2023, 11, 14, 22, 13, 20) - (0 if zone is None else 9 * 3600 * 1_000_000)
    assert sample.t_src == (None if zone is None else told)
    data = stats.latest.sample(stats).data
    assert isinstance(data, LinkStats)
    ours = EPOCH_US + int(1000.5 * 1e6)
    assert data.clock_offset == pytest.approx((told - ours) / 1e6, abs=0.01)
