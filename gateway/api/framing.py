"""How frames are delimited on the wire, as data, and the one decoder that follows it.

`Framing` says where magic, length, type, checksum and tail stand; `FramedDecoder` finds the frames.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from gateway.api.decoder import Event, Frame, Refused, Reject, Skipped
from gateway.api.layout import TYPES, Layout
from gateway.api.model import Quality
from gateway.api.numbers import Numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One type of frame: a row of a framing.

    Args:
        type: Value of the type field; None where the framing has none.
        name: Shown where such frames are counted.
        layouts: The tables of its known sizes, in any order; empty for a frame that carries no state and is skipped.
        smallest: Smallest total size in bytes that a header may promise.
        largest: Largest total size in bytes that a header may promise.
        step: The total size is a multiple of it.
    """

    type: int | None
    name: str
    layouts: tuple[Layout, ...] = ()
    smallest: int
    largest: int
    step: int = 1

    @property
    def carries_state(self) -> bool:
        """Whether frames of this kind are decoded, rather than skipped."""
        return bool(self.layouts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Checksum:
    """A checksum behind the payload.

    Args:
        type: Table type of the field.
        of: The value that the covered bytes (all before the field) must have.
    """

    type: str
    of: Callable[[bytes], int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """Where the parts of a frame stand.

    Args:
        magic: The first bytes of every frame.
        header: Bytes before the payload.
        length_at: Offset of the length field.
        length_type: Table type of the length field.
        length_adds: What must be added to the length field to give the total size in bytes.
        type_at: Offset of the one-byte type field, or None.
        kinds: The types of frames that exist.
        layout_at: Where in a frame the layouts' offset 0 is.
        checksum: The checksum before the tail, or None.
        tail: The last bytes of every frame.
        byteorder: `little` or `big`.
        one_length: Whether a session accepts only the length of its first good state frame. For protocols without a
            checksum, whose controllers never change it.
        counter_at: Offset of a one-byte counter that numbers the frames that carry state, or None.
        any_size: Whether a size that no table states is taken too, as far as the tables explain it: for tables that
            only ever grew at the end. Needs a checksum: without one, a wrong length could not be told from a new one.
    """

    magic: bytes
    header: int
    length_at: int
    length_type: str = "u16"
    length_adds: int = 0
    type_at: int | None = None
    kinds: tuple[Kind, ...]
    layout_at: int = 0
    checksum: Checksum | None = None
    tail: bytes = b""
    byteorder: Literal["little", "big"] = "little"
    one_length: bool = False
    counter_at: int | None = None
    any_size: bool = False

    def __post_init__(self) -> None:
        if self.any_size and self.checksum is None:
            raise ValueError("any_size needs a checksum")

    @property
    def behind(self) -> int:
        """How many bytes stand behind the payload: checksum and tail."""
        return len(self.tail) + (TYPES[self.checksum.type][2] if self.checksum else 0)

    @property
    def largest(self) -> int:
        """The largest total size in bytes that a header may promise: what one damaged header can cost."""
        return max(kind.largest for kind in self.kinds)


COUNTER_MODULUS = 256  # a counter has one byte
_Wrong = tuple[str, str]  # the reason and the detail of a Reject


class _Sizes:
    """The total sizes that frames of one kind may have."""

    def __init__(self, framing: Framing, kind: Kind) -> None:
        self.kind = kind
        self.any_size = framing.any_size
        self.layouts = {_total(framing, layout): layout for layout in kind.layouts}
        self.longest = max(self.layouts, default=0)

    def allow(self, total: int) -> bool:
        """Whether a header may promise this size: a known one, or a longer one, whose tail is then ignored."""
        if not self.kind.smallest <= total <= self.kind.largest or total % self.kind.step:
            return False
        return self.any_size or total in self.layouts or total > self.longest

    def table(self, total: int) -> tuple[Layout, Quality]:
        """The layout of a size, and how good its frames are.

        A size that no table states has the next longer table as far as the frame goes, or the longest.
        """
        exact = self.layouts.get(total)
        if exact is not None:
            return exact, Quality.GOOD
        longer = min((known for known in self.layouts if known > total), default=None)
        if longer is None:
            return self.layouts[self.longest], Quality.UNCERTAIN
        return _shortened(self.layouts[longer], total, longer - total), Quality.UNCERTAIN

    def __str__(self) -> str:
        known = ", ".join(str(size) for size in sorted(self.layouts))
        return f"{known} or more" if known else f"{self.kind.smallest} to {self.kind.largest}"


class FramedDecoder:
    """Finds the frames of a `Framing` in a stream that is cut anywhere.

    A wrong header costs one byte, then the search goes on: the next whole good frame is always found.
    """

    ready = True
    notes = ()

    def __init__(self, framing: Framing) -> None:
        self._framing = framing
        self._kinds = {kind.type: _Sizes(framing, kind) for kind in framing.kinds}
        self._starts = sorted({size for sizes in self._kinds.values() for size in sizes.layouts})
        self._buffer = b""
        self._length: int | None = None
        order = "<" if framing.byteorder == "little" else ">"
        self._length_of = struct.Struct(order + TYPES[framing.length_type][0]).unpack_from
        self._magic = framing.magic
        self._behind = framing.behind
        # Where a header tells length and type; what the last state frame told there, how long and of what kind it was.
        ends = [framing.length_at + TYPES[framing.length_type][2]]
        ends += [] if framing.type_at is None else [framing.type_at + 1]
        starts = [framing.length_at] if framing.type_at is None else [framing.length_at, framing.type_at]
        self._told = slice(min(starts), max(ends))
        self._usual_told, self._usual_size, self._usual = b"", -1, self._kinds[framing.kinds[0].type]
        self._table: tuple[Layout, Quality]
        self._counter_at = framing.counter_at
        self._numbers = Numbers(COUNTER_MODULUS)

    @property
    def gaps(self) -> int | None:
        """How many frames are missing by the controller's own counter; None: it tells no number."""
        return self._numbers.gaps

    @property
    def pending(self) -> int:
        """How many bytes wait in the buffer for the rest of their frame."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Event]:
        """Take received bytes and return what they completed."""
        if data[self._told] == self._usual_told and len(data) == self._usual_size and not self._buffer:
            # Nearly every chunk is exactly one frame like the last: nothing is to be searched or cut (ADR 0021).
            only = self._whole_frame(self._usual, data) if data.startswith(self._magic) else None
            if type(only) is Frame:
                return [only]
        return self._searched(data)

    def _searched(self, data: bytes) -> list[Event]:
        """What is found where frames are cut, several, damaged or of another kind."""
        buffer = self._buffer + data if self._buffer else data
        events: list[Event] = []
        size = len(buffer)
        at = dropped = 0
        reason = detail = ""
        magic = self._magic
        while at < size:
            found = buffer.find(magic, at)
            if found < 0:
                found = _partial_magic(buffer, magic, at)
                if found == at:
                    break  # the rest of the magic may follow
            if found != at:
                reason = reason or "junk"
                at = found
                continue
            outcome = self._frame_at(buffer, at, explain=not reason)
            if outcome is None:
                break
            if isinstance(outcome, tuple):
                if not reason:
                    reason, detail = outcome
                at += 1
                continue
            if dropped < at:
                events.append(Reject(buffer[dropped:at], reason, detail))
                reason = detail = ""
            events.append(outcome)
            at += len(outcome.raw)
            dropped = at
        if dropped < at:
            events.append(Reject(buffer[dropped:at], reason, detail))
        self._buffer = buffer[at:]
        return events

    def end(self) -> list[Reject]:
        """Return what is left in the buffer: a frame that never became whole."""
        left, self._buffer = self._buffer, b""
        if not left:
            return []
        promised = self._promised(left, 0)
        detail = f"the header promises {promised} bytes, {len(left)} came" if promised else f"{len(left)} bytes came"
        return [Reject(left, "truncated", detail)]

    def outgoing(self) -> bytes:
        """Nothing is owed: such streams are only read."""
        return b""

    def tick(self) -> bytes | Refused:
        """Nothing is asked: such streams are pushed."""
        return b""

    def goodbye(self) -> bytes:
        """Nothing is owed before a close."""
        return b""

    def _promised(self, buffer: bytes, at: int) -> int | None:
        """The total size that the header promises, or None while the header is not whole."""
        framing = self._framing
        if len(buffer) - at < framing.header:
            return None
        return int(self._length_of(buffer, at + framing.length_at)[0]) + framing.length_adds

    def _frame_at(self, buffer: bytes, at: int, *, explain: bool) -> Frame | Skipped | _Wrong | None:
        """The frame that begins at `at`; what is wrong where none does; None while more bytes are needed.

        A reject tells what was wrong first: without `explain` the words are spared, for a magic may be at every byte.
        """
        framing = self._framing
        total = self._promised(buffer, at)
        if total is None:
            return None
        type_ = None if framing.type_at is None else buffer[at + framing.type_at]
        sizes = self._kinds.get(type_)
        if sizes is None:
            known = ", ".join(str(known) for known in self._kinds) if explain else ""
            return "type", f"type {type_}, known are {known}"
        if not sizes.allow(total):
            header = buffer[at : at + framing.header].hex(" ") if explain else ""
            return "size", f"{sizes.kind.name} of {total} bytes (header {header}), known are {sizes}" if explain else ""
        if sizes.longest and self._length not in {None, total}:
            return "length", f"{sizes.kind.name} of {total} bytes in a session of {self._length} bytes"
        if len(buffer) - at < total:
            return None
        return self._whole_frame(sizes, buffer[at : at + total])

    def _whole_frame(self, sizes: _Sizes, raw: bytes) -> Frame | Skipped | _Wrong:
        """What the bytes that a good header promises are."""
        framing, total = self._framing, len(raw)
        if framing.tail and not raw.endswith(framing.tail):
            return "tail", f"ends {raw[-len(framing.tail) :].hex(' ')}, expected {framing.tail.hex(' ')}"
        if framing.checksum is not None and not _checksum_holds(framing, framing.checksum, raw, total - self._behind):
            return "checksum", f"{sizes.kind.name} of {total} bytes"
        if not sizes.longest:
            return Skipped(raw, sizes.kind.name)
        if framing.one_length and self._length is None:
            if any(self._begins(raw, start) for start in self._starts):
                return "straddle", f"{sizes.kind.name} of {total} bytes holds the header of another"
            self._length = total
        if self._counter_at is not None:
            self._numbers.take(raw[self._counter_at])
        if total != self._usual_size or sizes is not self._usual:
            self._usual, self._usual_size, self._usual_told = sizes, total, raw[self._told]
            self._table = sizes.table(total)
        layout, quality = self._table
        return Frame(raw, layout, framing.layout_at, quality)

    def _begins(self, raw: bytes, at: int) -> bool:
        """Whether a state frame may begin inside another, where one of a known size would have ended.

        Without a checksum this is what shows a damaged or wrong length that reaches into the next frame, however the
        stream is cut.
        """
        promised = self._promised(raw, at)
        if promised is None or not raw.startswith(self._framing.magic, at):
            return False
        type_at = self._framing.type_at
        sizes = self._kinds.get(None if type_at is None else raw[at + type_at])
        return sizes is not None and sizes.longest > 0 and sizes.allow(promised)


def _total(framing: Framing, layout: Layout) -> int:
    """Total size of a frame that a layout explains exactly."""
    return framing.layout_at + layout.size + framing.behind


@lru_cache(maxsize=64)
def _shortened(layout: Layout, total: int, missing: int) -> Layout:
    """A layout without its last bytes; always the same object, so that its readers are compiled once."""
    return layout.prefix(layout.size - missing, name=f"{total} bytes, the first of {layout.name}")


def _checksum_holds(framing: Framing, checksum: Checksum, raw: bytes, at: int) -> bool:
    told = raw[at : len(raw) - len(framing.tail)]
    return checksum.of(raw[:at]) == int.from_bytes(told, framing.byteorder)


def _partial_magic(buffer: bytes, magic: bytes, at: int) -> int:
    """Where the buffer's last bytes may begin a magic; its end if they cannot."""
    for start in range(max(at, len(buffer) - len(magic) + 1), len(buffer)):
        if magic.startswith(buffer[start:]):
            return start
    return len(buffer)
