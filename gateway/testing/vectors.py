r"""`vectors.toml`: frames and messages of a vendor, and what they must decode to.

    [[vectors]]                       the first that carries state is a usual frame: speed is measured with it
    name = "idle"                     unique in the file
    protocol = "reqdata"
    origin = "…"                      where bytes and values come from: a manual, a capture, another client
    hex = "24 40 …"                   the whole frame
    text = "jnt_pos : 0.1\r\n"          or the whole message of a text protocol, its end included
    base = "busy"                     or an earlier vector's bytes, then, in this order:
    cut = 512                           only so many of them
    append = "a1 a2"                    and these behind them
    patches = [{ at = 1, hex = "fc" }]  and these over them
    asked = "jnt_pos\r"               what was sent before it, where answers do not say what they answer
    before = ["hello"]                earlier vectors that the same decoder has read first
    layout = "580"                    for a frame that carries state: the name of its layout or record
    quality = "GOOD"                    and the quality of the frame
    skipped = "pop-up"                for a known frame that carries none
    occurrences = [{ kind = "command.issued", data = { … } }]   for one that tells what has happened
    options = { … }                   of the robot: estop_polarity, and the protocol's own
    vendor.jnt_ang = [1.0, …]         values by the manual's names; `word.flag` for bits
    canonical.joints = { q = "GOOD", position = [ … ] }   a whole group: what is not named must be null

TOML has no null: the text "null" stands for it. A vector with a base expects what its base expects, but for what it
states itself. Each vector is one unit on the wire and gives exactly one event.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from gateway.api.model import EventKind, Quality

NULL = "null"

Tree = dict[str, object]


class _Patch(msgspec.Struct, forbid_unknown_fields=True):
    at: int
    hex: str


class Expected(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One thing that a message says has happened.

    Attributes:
        kind: What happened.
        data: What the event's struct must hold: what is not named must be null.
        raw: The vendor's raw values, as far as they are named.
    """

    kind: EventKind
    data: Tree
    raw: Tree = {}


class _Row(msgspec.Struct, forbid_unknown_fields=True):
    """One vector as it stands in the file."""

    name: str
    protocol: str
    origin: str
    hex: str | None = None
    text: str | None = None
    base: str | None = None
    cut: int | None = None
    append: str = ""
    patches: list[_Patch] = []
    asked: str | None = None
    before: list[str] = []
    layout: str | None = None
    quality: Quality = Quality.GOOD
    skipped: str | None = None
    occurrences: list[Expected] = []
    options: Tree = {}
    vendor: Tree = {}
    canonical: dict[str, Tree] = {}


class _File(msgspec.Struct, forbid_unknown_fields=True):
    vectors: list[_Row] = []


@dataclass(frozen=True, slots=True, kw_only=True)
class Vector:
    """One frame and what it must decode to.

    Attributes:
        raw: The whole frame.
        asked: The bytes that were sent before it, or None where it needs no question.
        before: What the same decoder has read first.
        layout: Name of its table; None for a frame that carries no state.
        skipped: What a frame without state is counted as.
        occurrences: What has happened, by a message that tells that.
        vendor: Values by the manual's names, None for null.
        canonical: Whole groups, each with its `q`.
    """

    name: str
    protocol: str
    origin: str
    raw: bytes
    asked: bytes | None = None
    before: tuple[Vector, ...] = ()
    layout: str | None = None
    quality: Quality = Quality.GOOD
    skipped: str | None = None
    occurrences: tuple[Expected, ...] = ()
    options: Mapping[str, object] = field(default_factory=dict)
    vendor: Mapping[str, object] = field(default_factory=dict)
    canonical: Mapping[str, Mapping[str, object]] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"vector {self.name} ({len(self.raw)} bytes)"


def load(path: Path) -> tuple[Vector, ...]:
    """Read a file of vectors.

    Raises:
        ValueError: There is none, or it is not what it should be; says where and what to do.
    """
    try:
        rows = msgspec.convert(tomllib.loads(path.read_text()), _File).vectors
    except OSError as error:
        raise ValueError(
            f"{path} cannot be read: {error.strerror}. Add frames with the values they must give"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise ValueError(f"{path.name}: {error}. The format stands in gateway/testing/vectors.py") from error
    found: dict[str, Vector] = {}
    for row in rows:
        if row.name in found:
            raise ValueError(f"{path.name}: vector {row.name} stands twice: give each its own name")
        try:
            found[row.name] = _vector(row, found)
        except ValueError as error:
            raise ValueError(f"{path.name}: vector {row.name}: {error}") from error
    return tuple(found.values())


def _vector(row: _Row, earlier: Mapping[str, Vector]) -> Vector:
    _check_row(row, earlier)
    base = earlier[row.base] if row.base is not None else None
    vendor, canonical = _nulls(row.vendor), _nulls(row.canonical)
    asked = None if row.asked is None else row.asked.encode()
    before = tuple(earlier[name] for name in row.before)
    if base is not None:
        vendor, canonical = _merged(base.vendor, vendor), _merged(base.canonical, canonical)
        asked, before = base.asked if asked is None else asked, before or base.before
    whole = row.text.encode() if row.text is not None else bytes.fromhex(row.hex or "")
    return Vector(
        name=row.name,
        protocol=row.protocol,
        origin=row.origin,
        raw=_bytes(row, base.raw if base else whole),
        asked=asked,
        before=before,
        layout=row.layout,
        quality=row.quality,
        skipped=row.skipped,
        occurrences=tuple(msgspec.structs.replace(one, data=_nulls(one.data)) for one in row.occurrences),
        options=row.options,
        vendor=vendor,
        canonical=msgspec.convert(canonical, dict[str, dict[str, object]]),
    )


def _check_row(row: _Row, earlier: Mapping[str, Vector]) -> None:
    if [row.hex, row.text, row.base].count(None) != 2:  # noqa: PLR2004 - one of three
        raise ValueError("it needs one of `hex`, `text` and `base`")
    if [row.layout is None, row.skipped is None, not row.occurrences].count(False) != 1:
        raise ValueError("it needs one of `layout`, `skipped` and `occurrences`")
    if row.base is not None and row.base not in earlier:
        raise ValueError(f"its base {row.base!r} does not stand before it")
    unknown = [name for name in row.before if name not in earlier]
    if unknown:
        raise ValueError(f"it names {unknown[0]!r} in `before`, which does not stand before it")
    if row.asked == "":
        raise ValueError("`asked` is empty: leave it out where nothing was asked")


def _bytes(row: _Row, start: bytes) -> bytes:
    raw = bytearray(start[: row.cut] + bytes.fromhex(row.append))
    for patch in row.patches:
        new = bytes.fromhex(patch.hex)
        if not 0 <= patch.at <= len(raw) - len(new):
            raise ValueError(f"the patch at {patch.at} reaches behind the {len(raw)} bytes")
        raw[patch.at : patch.at + len(new)] = new
    return bytes(raw)


def _nulls(tree: Mapping[str, object]) -> Tree:
    return {name: _null(value) for name, value in tree.items()}


def _null(value: object) -> object:
    if value == NULL:
        return None
    if isinstance(value, dict):
        return _nulls(value)
    return [_null(item) for item in value] if isinstance(value, list) else value


def _merged(base: Mapping[str, object], over: Mapping[str, object]) -> Tree:
    """The base with what stands over it; tables are merged, everything else is replaced."""
    found = dict(base)
    for name, value in over.items():
        below = found.get(name)
        both = isinstance(below, dict) and isinstance(value, dict)
        found[name] = _merged(below, value) if both else value  # type: ignore[arg-type] # both are mappings
    return found
