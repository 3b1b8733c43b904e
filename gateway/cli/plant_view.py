"""`status --nats` and `tail --nats`: a whole plant in the terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial

import anyio
import msgspec

from gateway import logs
from gateway.api.describe import group_schema
from gateway.api.model import GROUPS, Event, Sample
from gateway.cli.common import FAILURE, USAGE, call, fail, tell, terminal
from gateway.cli.tail import Printer
from gateway.cli.view import robots_table
from gateway.config.exports import NatsAccess
from gateway.core.bus import Topic
from gateway.export.cells import CellSeen
from gateway.export.plant import PlantReader
from gateway.export.readings import ToldReading, told_event
from gateway.export.subjects import EVENT_GROUPS, Beat, Card, covers, is_word
from gateway.plant import Plant, reading

_ANSWER_S = 10.0
_TICK_S = 0.05
_SUBJECT_WORDS = 4


def plant_status(access: NatsAccess, name: str | None, *, as_json: bool) -> None:
    """Show every robot of a plant, once."""
    logs.configure("error")
    call(partial(_status, access, name, as_json=as_json))


async def _status(access: NatsAccess, name: str | None, *, as_json: bool) -> None:
    async with reading(access, name) as plant:
        with anyio.move_on_after(_ANSWER_S):
            while not plant.reader.ready.is_set() and plant.cells.connection in {None, "connecting"}:
                if "states" in plant.reader.notes:
                    break
                await anyio.sleep(_TICK_S)
        reason = plant.cells.connection or plant.reader.notes.get("states")
        if not plant.reader.ready.is_set():
            fail(reason or "the server does not answer", FAILURE)
        await _wait_for_beats(plant)
        infos = plant.cell.infos()
        latest = {
            topic.name: topic.latest.sample(topic)
            for topic in plant.bus.topics.values()
            if topic.group.name in {"status", "safety"} and topic.latest is not None
        }
        now_us = time.time_ns() // 1000
        if as_json:
            shown = [
                {
                    **msgspec.to_builtins(info),
                    "status": _data(latest, info.name, "status"),
                    "safety": _data(latest, info.name, "safety"),
                }
                for info in infos
            ]
            sys.stdout.write(msgspec.json.format(msgspec.json.encode(shown), indent=2).decode() + "\n")
            return
        console = terminal()
        if not plant.cells.cells:
            console.print(f"{plant.reader.plant}: no cell has sent anything yet")
            return
        console.print(robots_table(infos, latest, now_us, console.width))
        for line in cell_lines(plant):
            console.print(line)


async def _wait_for_beats(plant: Plant) -> None:
    """Wait until every cell that lives has said so, which takes a period of its heartbeat."""
    cells = plant.cells.cells.values()
    longest_s = max((cell.timeout_s() for cell in cells if not cell.fresh), default=0.0)
    with anyio.move_on_after(longest_s):
        while not all(cell.fresh for cell in cells):  # noqa: ASYNC110 - many cells, one look
            await anyio.sleep(_TICK_S)


def cell_lines(plant: Plant) -> Iterator[str]:
    """The cells, a line each."""
    for name, cell in sorted(plant.cells.cells.items()):
        yield f"{name}: {_cell_words(plant, cell)}"
    for what, reason in plant.reader.notes.items():
        yield f"{what}: {reason}"


def _cell_words(plant: Plant, cell: CellSeen) -> str:
    words = f"{'live' if cell.live else plant.cells.why_silent(cell)}, {len(cell.cards)} robots"
    if cell.beat is not None:
        words += f", on {cell.beat.host}, {cell.beat.waiting_events} events waiting"
        if cell.beat.dropped_events:
            words += f", {cell.beat.dropped_events} dropped"
    if cell.is_shared(time.monotonic()):
        words += "; two gateways send under this name: give each cell its own"
    return words


def _data(latest: dict[str, Sample], robot: str, group: str) -> object:
    sample = latest.get(f"{robot}/{group}")
    return None if sample is None else sample.data


def tail_plant(access: NatsAccess, subjects: list[str] | None, printer: Printer) -> None:
    """Print what a plant says: the last states first, then everything as it comes."""
    logs.configure("error")
    wanted = subjects or []
    if not wanted:
        fail("with --nats name subjects, such as 'plant1.*.*.safety' or 'plant1.cell7.>'", USAGE)
    plants = {subject.partition(".")[0] for subject in wanted}
    if len(plants) > 1 or not all(is_word(plant) for plant in plants) or any("." not in one for one in wanted):
        fail("with --nats topics are subjects of one plant, such as 'plant1.*.*.safety' or 'plant1.cell7.>'", USAGE)
    call(partial(_tail, access, plants.pop(), wanted, printer))


async def _tail(access: NatsAccess, plant: str, subjects: list[str], printer: Printer) -> None:
    told = _Printed(plant, subjects, printer)
    reader = PlantReader(access, told, plant, groups=list(_groups(subjects)), history_s=0.0)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(reader.run)
        await told.done.wait()
        tasks.cancel_scope.cancel()


def _groups(subjects: Iterable[str]) -> Iterator[str]:
    """The sample groups that some subjects may name."""
    words = {subject.split(".")[-1] if len(subject.split(".")) == _SUBJECT_WORDS else ">" for subject in subjects}
    for name, group in GROUPS.items():
        if group.delivery == "sample" and words & {name, "*", ">"}:
            yield name


class _Printed:
    """Prints what it is told, as far as it is wanted."""

    def __init__(self, plant: str, subjects: list[str], printer: Printer) -> None:
        self._plant = plant
        self._subjects = subjects
        self._printer = printer
        self._lost = False
        self.connection: str | None = "connecting"
        self.done = anyio.Event()

    def connected(self) -> None:
        """The server is there."""
        if self._lost:
            tell("connected:", "green", "again")
        self.connection, self._lost = None, False

    def lost(self, reason: str) -> None:
        """The server is gone."""
        if not self._lost:
            tell("disconnected:", "red", f"{reason} - trying again")
        self.connection, self._lost = reason, True

    def look(self) -> None:
        """Nothing is shown of time alone."""

    def wrong(self) -> None:
        """It is not printed."""

    def beat(self, name: str, beat: Beat, *, kept: bool = False) -> None:
        """It is not printed."""

    def robots(self, name: str, cards: list[Card]) -> None:
        """They are not printed."""

    def forget(self, cell_name: str, robot: str, group: str) -> None:
        """Nothing is printed of what is gone."""

    def sample(self, cell_name: str, robot: str, group: str, payload: bytes) -> None:
        """Print a sample or a state."""
        if not self._wants(cell_name, robot, group) or group not in GROUPS:
            return
        topic = Topic(f"{cell_name}/{robot}", GROUPS[group])
        try:
            sample = ToldReading(payload).sample(topic)
        except msgspec.DecodeError:
            return
        self._printer.learn(topic.name, group_schema(group))
        self._print(msgspec.structs.replace(sample, data=msgspec.to_builtins(sample.data)))

    def event(self, cell_name: str, robot: str, group: str, payload: bytes) -> None:
        """Print an event, under the name that its gateway gave it."""
        if group in EVENT_GROUPS and self._wants(cell_name, robot, group):
            try:
                event = told_event(payload)
            except msgspec.DecodeError:
                return
            self._print(msgspec.structs.replace(event, robot=f"{cell_name}/{event.robot}"))

    def _print(self, item: Sample | Event) -> None:
        if self.done.is_set():
            return
        if not self._printer.take(item):
            self.done.set()
        sys.stdout.flush()

    def _wants(self, *words: str) -> bool:
        name = ".".join((self._plant, *words))
        return any(covers(subject, name) for subject in self._subjects)
