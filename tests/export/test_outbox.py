"""The outbox: what is in it stays through everything, and it never grows over its bounds."""

from __future__ import annotations

import os
from pathlib import Path

import anyio
import pytest

from gateway.export.encoding import Encoder
from gateway.export.outbox import ROW_BYTES, Outbox, OutboxError, Row
from gateway.export.subjects import covers, is_word, message_id
from gateway.export.taking import EventTaker
from tests.export.kit import until
from tests.server.kit import cell, raise_event


class Clock:
    def __init__(self) -> None:
        self.at_s = 1_700_000_000.0

    def __call__(self) -> float:
        return self.at_s


def row(number: int, size: int = 100) -> Row:
    return Row(f"b:{number}", "r1", "events", b"x" * size)


async def names(outbox: Outbox) -> list[int]:
    return [int(one.name.partition(":")[2]) for one in await outbox.first(1000)]


async def test_what_is_put_in_is_there_after_a_new_start_in_order_and_with_how_far_the_ring_was_read(
    tmp_path: Path,
) -> None:
    path = tmp_path / "deep" / "outbox.sqlite"
    outbox = Outbox(path, 1e6, 1e6)
    assert await outbox.open() == {}
    await outbox.put([row(1), row(2)], {"b": 2})
    await outbox.put([row(3)], {"b": 3})
    await outbox.remove([1])
    await outbox.close()
    again = Outbox(path, 1e6, 1e6)
    assert await again.open() == {"b": 3}
    assert await names(again) == [2, 3]
    assert (again.fill.events, again.fill.n_bytes) == (2, 2 * (100 + ROW_BYTES))
    await again.close()


async def test_the_oldest_go_when_there_is_no_room_and_are_counted(tmp_path: Path) -> None:
    outbox = Outbox(tmp_path / "o.sqlite", 5 * (100 + ROW_BYTES), 1e6)
    await outbox.open()
    assert await outbox.put([row(number) for number in range(1, 4)], {}) == 0
    assert await outbox.put([row(number) for number in range(4, 9)], {}) == 3
    assert await names(outbox) == [4, 5, 6, 7, 8]
    assert (outbox.fill.events, outbox.fill.dropped) == (5, 3)
    await outbox.close()
    again = Outbox(tmp_path / "o.sqlite", 1e6, 1e6)
    await again.open()
    assert again.fill.dropped == 3
    await again.close()


async def test_what_is_too_old_goes_also_when_nothing_comes(tmp_path: Path) -> None:
    clock = Clock()
    outbox = Outbox(tmp_path / "o.sqlite", 1e6, 60.0, clock)
    await outbox.open()
    await outbox.put([row(1)], {})
    clock.at_s += 50
    await outbox.put([row(2)], {})
    clock.at_s += 20
    assert await outbox.put([], {}) == 1
    assert await names(outbox) == [2]
    await outbox.close()


async def test_a_damaged_file_is_put_aside_and_a_new_one_begun(tmp_path: Path) -> None:
    path = tmp_path / "o.sqlite"
    path.write_bytes(b"this is no database, but it is long enough to be looked at" * 100)
    outbox = Outbox(path, 1e6, 1e6)
    await outbox.open()
    await outbox.put([row(1)], {})
    assert await names(outbox) == [1]
    await outbox.close()
    assert [one.partition("damaged")[1] for one in os.listdir(tmp_path) if one != path.name] == ["damaged"]  # noqa: PTH208


async def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutboxError, match="file"):
        await Outbox(tmp_path / "file" / "o.sqlite", 1e6, 1e6).open()


async def test_what_happened_while_the_exporter_was_away_is_read_from_the_ring(tmp_path: Path) -> None:
    bus, _ = cell("r1")
    outbox = Outbox(tmp_path / "o.sqlite", 1e6, 1e6)
    for _ in range(2):
        taker = EventTaker(bus, outbox, ("events",), Encoder("json").encode)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(taker.run)
            raise_event(bus, "r1")
            await until(lambda: outbox.fill.events >= bus.events.last_seq)
            tasks.cancel_scope.cancel()
        assert not bus.topics["r1/events"].listeners
        for _ in range(700):
            raise_event(bus, "r1")
    taker = EventTaker(bus, outbox, ("events",), Encoder("json").encode)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(taker.run)
        await until(lambda: outbox.fill.events >= bus.events.last_seq)
        found = await outbox.first(10_000)
        tasks.cancel_scope.cancel()
    assert [one.name for one in found] == [f"b00t:{number}" for number in range(1, 1403)]


async def test_what_is_gone_from_the_ring_before_it_could_be_stored_is_counted(tmp_path: Path) -> None:
    bus, _ = cell("r1", ring=10)
    for _ in range(25):
        raise_event(bus, "r1")
    outbox = Outbox(tmp_path / "o.sqlite", 1e6, 1e6)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(EventTaker(bus, outbox, ("events",), Encoder("json").encode).run)
        await until(lambda: outbox.fill.events == 10)
        tasks.cancel_scope.cancel()
    assert outbox.fill.dropped == 15


def test_the_words_of_a_subject() -> None:
    assert is_word("cell-1_A")
    assert not any(map(is_word, ("", "a.b", "a b", "a*", ">", "ü", "a\n", "x" * 33)))
    assert message_id("cell1", "b00t:17") == "cell1.b00t:17"


@pytest.mark.parametrize(
    ("pattern", "name", "is_covered"),
    [
        ("plant1.*.*.events", "plant1.c.r.events", True),
        ("plant1.>", "plant1.c.r.events", True),
        ("plant1.*.*.safety", "plant1.c.r.events", False),
        ("plant1.*", "plant1.c.r.events", False),
        ("plant1.c.r.events.>", "plant1.c.r.events", False),
        ("plant2.>", "plant1.c.r.events", False),
    ],
)
def test_patterns_of_subjects(pattern: str, name: str, *, is_covered: bool) -> None:
    assert covers(pattern, name) is is_covered
