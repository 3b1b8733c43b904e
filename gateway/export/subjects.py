"""What the subjects, keys and documents of a plant are called: `<plant>.<cell>.<robot>.<group>`."""

from __future__ import annotations

import re
from typing import Annotated

import msgspec
from msgspec import Meta

GATEWAY, ROBOTS = "gateway", "robots"  # the two keys of a cell that belong to no robot
EVENT_GROUPS = ("events", "commands")
_WORD = re.compile(r"[A-Za-z0-9_-]{1,32}")


class Beat(msgspec.Struct, frozen=True, kw_only=True):
    """The key `<cell>.gateway`: the gateway lives."""

    boot: Annotated[str, Meta(description="New at each start of the gateway: the boot of its events.")]
    n: Annotated[int, Meta(description="Counts the beats.")]
    t: Annotated[int, Meta(description="The gateway's time, UTC since 1970.", extra_json_schema={"unit": "µs"})]
    period: Annotated[float, Meta(description="Time to the next one.", extra_json_schema={"unit": "s"})]
    gateway: Annotated[str, Meta(description="Its version.")]
    host: Annotated[str, Meta(description="Name of its machine.")]
    waiting_events: int = 0
    dropped_events: int = 0


class Card(msgspec.Struct, frozen=True, kw_only=True):
    """One robot of the key `<cell>.robots`."""

    name: str
    vendor: str
    protocol: str
    groups: list[str]


def is_word(text: str) -> bool:
    """Whether a text can be one word of a subject."""
    return _WORD.fullmatch(text) is not None


def subject(plant: str, cell: str, robot: str, group: str) -> str:
    """The subject of a topic."""
    return f"{plant}.{cell}.{robot}.{group}"


def message_id(cell: str, name: str) -> str:
    """The `Nats-Msg-Id` of an event: the cell and the event's own name, `boot:seq`."""
    return f"{cell}.{name}"


def event_subjects(plant: str) -> list[str]:
    """What the stream of a plant's events holds."""
    return [f"{plant}.*.*.{group}" for group in EVENT_GROUPS]


def covers(pattern: str, name: str) -> bool:
    """Whether a pattern of a stream (`plant1.*.*.events`, `plant1.>`) takes a subject."""
    words, parts = pattern.split("."), name.split(".")
    for index, word in enumerate(words):
        if word == ">":
            return len(parts) > index
        if index >= len(parts) or word not in {"*", parts[index]}:
            return False
    return len(words) == len(parts)
