"""Chaos: faults of the bytes that a virtual controller sends, each with a rate or a time, reproducible from a seed.

It works on whole segments, decides and cuts, but sends nothing: the server delivers what comes out.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

# name -> (what its values are, what it does)
_FAULTS = {
    "split": ("RATE", "cut at any bytes, the parts a little later"),
    "coalesce": ("RATE", "one send with a frame without state, or the next"),
    "skip": ("RATE", "a frame without state comes before"),
    "double": ("RATE", "sent twice in one send"),
    "junk": ("RATE", "random bytes come before"),
    "header": ("RATE", "one byte of the header is damaged"),
    "corrupt": ("RATE", "one byte anywhere is damaged"),
    "checksum": ("RATE", "the last two bytes are wrong"),
    "tail": ("RATE", "the last bytes are missing"),
    "delay": ("RATE/SECONDS", "late by so many seconds"),
    "stall": ("SECONDS/EVERY", "silence for so long in every so many, then answers"),
    "cut": ("EVERY", "the connection is closed after so many"),
}
_TIMED = {"delay": 2, "stall": 2}
_MOST_JUNK = 64
_MOST_PARTS = 4
_MOST_MISSING = 8
_SPLIT_WAIT_S = (0.0, 0.004)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChaosPlan:
    """Which faults happen, and how often; rates are from 0 to 1 for each frame, 0 s is never."""

    split: float = 0.0
    coalesce: float = 0.0
    skip: float = 0.0
    double: float = 0.0
    junk: float = 0.0
    header: float = 0.0
    corrupt: float = 0.0
    checksum: float = 0.0
    tail: float = 0.0
    delay: float = 0.0
    delay_s: float = 0.0
    stall_s: float = 0.0
    stall_every_s: float = 0.0
    cut_every_s: float = 0.0

    @property
    def is_calm(self) -> bool:
        """Whether nothing happens at all."""
        return not any(dataclasses.astuple(self))

    def silent(self, elapsed_s: float) -> bool:
        """Whether the controller is silent at a time since it was started: a stall ends each period."""
        return self.silence_left_s(elapsed_s) > 0

    def silence_left_s(self, elapsed_s: float) -> float:
        """How long the controller will still be silent; 0 when it is not."""
        if not self.stall_every_s:
            return 0.0
        left_s = self.stall_every_s - elapsed_s % self.stall_every_s
        return left_s if left_s <= self.stall_s else 0.0


CALM = ChaosPlan()


def explain() -> str:
    """List the faults, one line each, for people."""
    rows = [(f"{name}={form}", meaning) for name, (form, meaning) in _FAULTS.items()]
    width = max(len(form) for form, _ in rows)
    return "\n".join(f"{form:{width}}  {meaning}" for form, meaning in rows)


def parse_chaos(text: str) -> ChaosPlan:
    """Read a plan such as `split=0.2,junk=0.05,stall=2/10,cut=5`.

    Raises:
        ValueError: The text says something else; the message says what is wrong and what is allowed.
    """
    found: dict[str, float] = {}
    seen: set[str] = set()
    for item in filter(None, (part.strip() for part in text.split(","))):
        name, _, value = (part.strip() for part in item.partition("="))
        if name not in _FAULTS:
            raise ValueError(f"chaos {name!r} is unknown; known are {', '.join(_FAULTS)}")
        if name in seen:
            raise ValueError(f"chaos {name} stands twice")
        seen.add(name)
        found.update(_values(name, value))
    return ChaosPlan(**found)


def _values(name: str, value: str) -> dict[str, float]:
    form = _FAULTS[name][0]
    allowed = f"chaos {name} takes {name}={form}"
    try:
        numbers = [float(part) for part in value.split("/")]
    except ValueError:
        raise ValueError(f"{allowed}, not {value!r}") from None
    if len(numbers) != _TIMED.get(name, 1):
        raise ValueError(f"{allowed}, not {value!r}")
    if form.startswith("RATE") and not 0 <= numbers[0] <= 1:
        raise ValueError(f"{allowed} with a rate from 0 to 1, not {numbers[0]:g}")
    if not all(0 <= number < float("inf") for number in numbers):
        raise ValueError(f"{allowed} with times in s that are not negative, not {value!r}")
    if name == "stall" and not 0 < numbers[0] < numbers[1]:
        raise ValueError(f"{allowed} with 0 < SECONDS < EVERY, not {value!r}")
    if name == "cut" and numbers[0] == 0:
        raise ValueError(f"{allowed} with more than 0 s")
    return dict(zip(_KEYS.get(name, (name,)), numbers, strict=True))


_KEYS = {"delay": ("delay", "delay_s"), "stall": ("stall_s", "stall_every_s"), "cut": ("cut_every_s",)}


@dataclass(frozen=True, slots=True)
class Delivery:
    """One send, and how long after the one before it may leave."""

    wait_s: float
    data: bytes


class Chaos:
    """The faults of one connection.

    Args:
        plan: What may happen.
        random: Decides; seeded by the caller.
        header: How many bytes of a frame are its header.
        fillers: Known frames that carry no state, to be sent in between.
        counts: Counts what happened, by name.
    """

    def __init__(
        self,
        plan: ChaosPlan,
        random: Random,
        *,
        header: int,
        fillers: Sequence[bytes],
        counts: Counter[str],
    ) -> None:
        self.plan = plan
        self._random = random
        self._header = header
        self._fillers = fillers
        self._counts = counts
        self._held = b""

    def deliver(self, segments: Sequence[bytes]) -> list[Delivery]:
        """Turn segments into sends, faults included."""
        return [delivery for segment in segments for delivery in self._one(segment)]

    def _one(self, segment: bytes) -> list[Delivery]:
        plan = self.plan
        wait_s = plan.delay_s if self._happens("delay", plan.delay) else 0.0
        data = self._damaged(segment)
        if self._happens("double", plan.double):
            data += data
        before: list[Delivery] = []
        if self._fillers and self._happens("skip", plan.skip):
            before.append(Delivery(0.0, self._random.choice(self._fillers)))
        if self._happens("junk", plan.junk):
            junk = self._random.randbytes(self._random.randint(1, _MOST_JUNK))
            if self._random.random() < 0.5:  # noqa: PLR2004 - one half leaves in a send of its own
                before.append(Delivery(0.0, junk))
            else:
                data = junk + data
        if self._happens("coalesce", plan.coalesce):
            if not self._fillers:
                self._held += data
                return before
            filler = self._random.choice(self._fillers)
            data = self._random.choice((filler + data, data + filler))
        data, self._held = self._held + data, b""
        parts = self._parts(data)
        return [
            *before,
            Delivery(wait_s, parts[0]),
            *(Delivery(self._random.uniform(*_SPLIT_WAIT_S), p) for p in parts[1:]),
        ]

    def _damaged(self, segment: bytes) -> bytes:
        plan = self.plan
        if self._header and self._happens("header", plan.header):
            segment = self._flip(segment, self._random.randrange(min(self._header, len(segment))))
        if self._happens("corrupt", plan.corrupt):
            segment = self._flip(segment, self._random.randrange(len(segment)))
        if self._happens("checksum", plan.checksum):
            segment = self._flip(self._flip(segment, len(segment) - 1), len(segment) - 2)
        if self._happens("tail", plan.tail):
            segment = segment[: -self._random.randint(1, min(_MOST_MISSING, len(segment) - 1))]
        return segment

    def _flip(self, segment: bytes, at: int) -> bytes:
        return segment[:at] + bytes([segment[at] ^ self._random.randint(1, 255)]) + segment[at + 1 :]

    def _parts(self, data: bytes) -> list[bytes]:
        if len(data) < _MOST_PARTS or not self._happens("split", self.plan.split):
            return [data]
        cuts = sorted(self._random.sample(range(1, len(data)), self._random.randint(1, _MOST_PARTS - 1)))
        return [data[start:end] for start, end in zip((0, *cuts), (*cuts, len(data)), strict=True)]

    def _happens(self, name: str, rate: float) -> bool:
        if not rate or self._random.random() >= rate:
            return False
        self._counts[name] += 1
        return True
