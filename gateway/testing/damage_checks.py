"""Checks of damage: every byte of every vector changed in turn, inside a stream and at its beginning.

With a checksum damage is never delivered. Without one, damage in a value leaves every boundary and every other value;
damage in the bytes that say where a frame begins and ends costs at most the largest frame, and nothing is delivered
that mixes two frames.

Every byte of every different vector is damaged; in how many ways depends on what could go wrong with it, and each check
says so.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from gateway.api.decoder import Frame
from gateway.api.layout import Field, Layout
from gateway.testing.readings import Plain, read_group
from gateway.testing.streams import BITS, DAMAGES, Placed, check_conserved, damaged, feed_all, placed, structure
from gateway.testing.subject import CheckFailed, DoesNotApply, Subject, layout_of
from gateway.testing.vector_checks import the_frame
from gateway.testing.vectors import Vector

_Place = tuple[int, int]  # offset of a byte, and its changed bits


def damaged_values_move_nothing(subject: Subject) -> None:
    """Without a checksum, damage in a value leaves every boundary: all frames come, the damaged one too.

    Each byte in four ways, inside a stream and at its beginning: nothing but the boundaries can show it.
    """
    if subject.framing.checksum is not None:
        raise DoesNotApply("the frames have a checksum: damage_never_passes looks at them")
    for vector, good in _different(subject):
        values = sorted(set(range(len(vector.raw))) - structure(subject.framing, vector.raw))
        before = good.raw if len(good.raw) == len(vector.raw) or not subject.framing.one_length else b""
        for at, damage in _every(values):
            hurt = damaged(vector.raw, at, damage)
            for parts in ([before, hurt, good.raw, good.raw], [hurt, good.raw, good.raw]):
                stream = [part for part in parts if part]
                events = subject.protocol.reader().feed(b"".join(stream))
                if [getattr(event, "raw", b"") for event in events] != stream:
                    raise CheckFailed(
                        f"{vector} with byte {at} damaged, a value, gives {', '.join(map(str, events))} instead of "
                        f"{len(stream)} frames: find boundaries by header and length alone",
                    )


def damaged_values_stay_alone(subject: Subject) -> None:
    """Damage in a byte changes the field, the element and the bits that stand there, and nothing else.

    Each byte once, all its bits; where it belongs to flags, each bit by itself too.
    """
    for vector in (vector for session in subject.sessions for vector in session):
        frame = the_frame(subject, vector)
        if frame is None:
            continue
        layout = layout_of(frame)
        flagged = _flagged(layout)
        normaliser = subject.normaliser(vector.options)
        before = read_group(normaliser, "vendor", frame).data
        for at in range(layout.size):
            for damage in (0xFF, *BITS) if at in flagged else (0xFF,):
                hurt = damaged(frame.raw, frame.start + at, damage)
                after = read_group(normaliser, "vendor", Frame(hurt, frame.layout, frame.start)).data
                _check_alone(str(vector), layout, (at, damage), before, after)


def damaged_headers_cost_little(subject: Subject) -> None:
    """Damage where a frame begins and ends costs at most the largest frame, and the next whole good frame is found.

    In the header every other value of each byte; behind the payload, where a value can only be right or wrong, four.
    """
    framing = subject.framing
    for vector, good in _different(subject):
        for at in sorted(structure(framing, vector.raw)):
            if at < framing.header:
                hurts = [vector.raw[:at] + bytes((byte,)) + vector.raw[at + 1 :] for byte in range(256)]
            else:
                hurts = [damaged(vector.raw, at, damage) for damage in DAMAGES]
            for hurt in hurts:
                if hurt != vector.raw:
                    _check_header(subject, vector, hurt, good, at)


def damage_never_passes(subject: Subject) -> None:
    """With a checksum, no damaged frame is delivered, and no other frame is lost to damage in a value.

    Each byte in one of four ways in turn: a checksum that covers a byte shows any change of it, and whether a frame is
    delivered is told by its bytes alone.
    """
    framing = subject.framing
    if framing.checksum is None:
        raise DoesNotApply("the frames have no checksum: damaged_values_move_nothing looks at them")
    for vector, good in _different(subject):
        values = sorted(set(range(len(vector.raw))) - structure(framing, vector.raw))
        for at in values:
            damage = DAMAGES[at % len(DAMAGES)]
            stream = good.raw + damaged(vector.raw, at, damage) + good.raw * 2
            found = [event.raw for event in subject.protocol.reader().feed(stream) if isinstance(event, Frame)]
            if found != [good.raw] * 3:
                raise CheckFailed(
                    f"{vector} with byte {at} damaged: {len(found)} frames come, where the three good ones should: "
                    "let the checksum cover every byte before it, and reject what does not match",
                )


def _check_header(subject: Subject, vector: Vector, hurt: bytes, good: Vector, at: int) -> None:
    largest = subject.framing.largest
    count = largest // len(good.raw) + 3
    before = good.raw if len(good.raw) == len(vector.raw) or vector.layout is None else b""
    for lead in {before, b""}:
        start = len(lead)
        parts = [lead, hurt, *[good.raw] * count]
        decoder = subject.protocol.reader()
        events = feed_all(decoder, parts)
        where = f"{vector} with byte {at} changed to 0x{hurt[at]:02x}{'' if lead else ', first in its session'}"
        check_conserved(b"".join(parts), events, decoder.end(), f"frame by frame ({where})")
        found = [place for place in placed(events) if isinstance(place.event, Frame)]
        spans = [(0, start)] if lead else []
        spans += [(start, start + len(hurt))]
        spans += [
            (start + len(hurt) + n * len(good.raw), start + len(hurt) + (n + 1) * len(good.raw)) for n in range(count)
        ]
        _check_inside(found, spans, where)
        in_magic = at < len(subject.framing.magic)
        if in_magic and any(place.start == start for place in found):
            raise CheckFailed(f"{where} is still taken for a frame: check the magic")
        missing = _missed(found, spans, start + largest)
        if missing and (lead or not _session_lost(found, spans, start)):
            raise CheckFailed(
                f"{where} costs more than the {largest} bytes of the largest frame: the good frame at byte "
                f"{missing[0]} is not delivered: search on one byte behind a header that proves wrong",
            )


def _check_inside(found: Iterable[Placed], spans: Sequence[tuple[int, int]], where: str) -> None:
    """Check that what a layout reads lies in one frame."""
    for place in found:
        frame = place.event
        if not isinstance(frame, Frame):
            continue
        first = place.start + frame.start
        if not any(start == place.start and first + layout_of(frame).size <= end for start, end in spans):
            raise CheckFailed(
                f"{where}: {frame} at byte {place.start} mixes two frames: refuse a length that the session did not "
                "begin with (one_length), or one that reaches over a header",
            )


def _missed(found: Iterable[Placed], spans: Iterable[tuple[int, int]], after: int) -> list[int]:
    starts = {place.start for place in found}
    return [start for start, _ in spans if start >= after and start not in starts]


def _session_lost(found: Sequence[Placed], spans: Sequence[tuple[int, int]], start: int) -> bool:
    """Whether damage to the first frame cost the session: it was delivered cut, and nothing false came after."""
    return len(found) == 1 and found[0].start == start == spans[0][0]


def _check_alone(where: str, layout: Layout, place: _Place, before: Plain, after: Plain) -> None:
    at, changed = place
    for field in layout.fields:
        was, now = before[field.name], after[field.name]
        if was == now:
            continue
        old, new = (was, now) if isinstance(was, list) and isinstance(now, list) else ([was], [now])
        for index, (a, b) in enumerate(zip(old, new, strict=True)):
            if a == b:
                continue
            first = field.offset + index * field.item_size
            if not first <= at < first + field.item_size:
                raise CheckFailed(
                    f"{where}: byte {at} changes {field.name}[{index}], which stands at {first}: correct the table"
                )
            if isinstance(a, dict) and isinstance(b, dict):
                _check_bits(field, _in_word(field, layout, at - first, changed), a, b)


def _flagged(layout: Layout) -> set[int]:
    """The bytes that belong to flags."""
    fields = [field for field in layout.fields if field.flags]
    return {at for field in fields for at in range(field.offset, field.offset + field.present * field.item_size)}


def _in_word(field: Field, layout: Layout, byte: int, changed: int) -> int:
    """The changed bits of one byte, as bits of the word."""
    place = byte if layout.byteorder == "<" else field.item_size - 1 - byte
    return changed << 8 * place


def _check_bits(field: Field, bits: int, was: Plain, now: Plain) -> None:
    for flag in field.flags:
        if was[flag.name] != now[flag.name] and not bits & flag.mask << flag.bit:
            raise CheckFailed(f"bits 0x{bits:x} change {field.name}.{flag.name}, bit {flag.bit}: correct bit or width")


def _different(subject: Subject) -> Iterator[tuple[Vector, Vector]]:
    """Every different vector, with a good state vector that may follow it in its session."""
    for session in subject.sessions:
        yield from ((vector, session[0]) for vector in session)
    for vector in subject.skipped:
        yield vector, subject.sessions[0][0]


def _every(places: Iterable[int]) -> Iterator[tuple[int, int | None]]:
    return ((at, damage) for at in places for damage in DAMAGES)
