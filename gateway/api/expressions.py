"""From signal rows to the source of expressions over the words of a frame; `compiler` makes functions of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gateway.api import model, units
from gateway.api.layout import Field, Layout
from gateway.api.rotations import QUATERNION_FROM
from gateway.api.signals import Signal, find_source, leaf
from gateway.api.words import Words, flag_expression


def word_expression(field: Field, ref: str, *, nulls: bool) -> str:
    """The vendor group's expression for one element: the value, or an object of the raw word and its flags."""
    if not field.flags or ref == "None":
        return ref
    flags = ", ".join(f"{flag.name!r}: {flag_expression(ref, flag)}" for flag in field.flags)
    shown = f"{{'raw': {ref}, {flags}}}"
    return f"(None if {ref} is None else {shown})" if nulls else shown


def row_expression(
    row: Signal,
    words: Words,
    names: dict[str, object],
    options: Mapping[str, object],
    *,
    nulls: bool,
) -> str:
    """The expression that a row's key follows from."""
    goal = leaf(row.key)
    if row.via is not None:
        return _via_expression(row, words, names, options, nulls=nulls)
    values = [value for source in row.sources for value in words.values(source)]
    if all(value is None for value in values):
        return "None"
    found = {find_source(words.layout, source)[0].unit for source in row.sources}
    if len(found) > 1:
        raise ValueError(f"{row.key}: its sources have different units: {found}")
    unit = found.pop()
    if goal.shape == "pose":
        return _pose_expression(row, values, unit, names, nulls=nulls)
    if goal.shape == "channels":
        si, items = _channel_items(row, values, unit, nulls=nulls)
        names["Channels"] = model.Channels
        return f"Channels([{items}], {si!r})"
    each = [(unit, goal.unit)] * len(values)
    if goal.shape == "array" and unit is not None and goal.unit is not None:
        each = [*units.shares(unit, goal.unit, len(values))]
    items_list = [
        _item(row, value, own, si, goal.shape, nulls=nulls) for value, (own, si) in zip(values, each, strict=True)
    ]
    if goal.shape in {"array", "bits"}:
        return f"[{', '.join(items_list)}]"
    if goal.shape in {"float", "int", "bool"} and len(items_list) == 1:
        return items_list[0]
    raise ValueError(f"{row.key}: {len(items_list)} values need a function (via) to become {goal.shape}")


def _via_expression(
    row: Signal,
    words: Words,
    names: dict[str, object],
    options: Mapping[str, object],
    *,
    nulls: bool,
) -> str:
    arguments, checked = [], []
    for source in row.sources:
        field, _ = find_source(words.layout, source)
        values = words.values(source)
        if not row.partial and any(value is None for value in values):
            return "None"
        absent = all(value is None for value in values)
        shown = ["None" if value is None else value for value in values]
        arguments.append("None" if absent else shown[0] if field.count is None else f"[{', '.join(shown)}]")
        checked += [ref for ref in words.refs(source) if field.is_float]
    for option in row.options:
        if option not in options:
            raise ValueError(f"{row.key}: the robot has no option {option!r}")
        names[f"option_{option}"] = options[option]
        arguments.append(f"{option}=option_{option}")
    function = f"via_{'_'.join((row.group, *row.path))}"
    names[function] = row.via
    call = f"{function}({', '.join(arguments)})"
    if nulls and checked and not row.partial:
        return f"(None if {' or '.join(f'{ref} is None' for ref in checked)} else {call})"
    return call


def calm_expression(row: Signal, layout: Layout, options: Mapping[str, object]) -> str:
    """The expression of a calm row while its sources are 0.

    Raises:
        ValueError: `via` says something else then.
    """
    fields = [find_source(layout, source)[0] for source in row.sources]
    zeros = [0 if field.count is None else [0] * field.elements for field in fields]
    if row.via is None or row.calm is None:
        raise ValueError(f"{row.key}: calm stands for what a function says")
    told = row.via(*zeros, **{option: options[option] for option in row.options})
    if told != row.calm() or type(told) is not type(row.calm()):
        raise ValueError(f"{row.key}: of zeros {row.via.__name__} says {told!r}, calm says {row.calm()!r}")
    return repr(row.calm())


def _pose_expression(
    row: Signal,
    values: Sequence[str | None],
    unit: str | None,
    names: dict[str, object],
    *,
    nulls: bool,
) -> str:
    if unit is None or "|" not in unit or any(value is None for value in values):
        if unit is not None and "|" in unit:
            return "None"
        raise ValueError(f"{row.key}: a pose needs a source in `mm|deg` or the like, not {unit!r}")
    length, angle = unit.split("|")
    present = [value for value in values if value is not None]
    scaled = [_scaled(value, length, "m") for value in present[:3]] + [
        _scaled(value, angle, "rad") for value in present[3:]
    ]
    orientation = "None"
    if row.rotation:
        orientation = f"quaternion_{row.rotation}({', '.join(scaled[3:])})"
        names[f"quaternion_{row.rotation}"] = QUATERNION_FROM[row.rotation]
    names["Pose"] = model.Pose
    made = f"Pose([{', '.join(scaled[:3])}], {orientation})"
    return f"(None if {' or '.join(f'{value} is None' for value in present)} else {made})" if nulls else made


def _channel_items(row: Signal, values: Sequence[str | None], unit: str | None, *, nulls: bool) -> tuple[str, str]:
    if unit is None:
        raise ValueError(f"{row.key}: channels without a unit need a function (via) that fills `raw`")
    si = next(si for si in ("V", "A") if _converts(unit, si))
    return si, ", ".join(_item(row, value, unit, si, "float", nulls=nulls) for value in values)


def _converts(unit: str, si: str) -> bool:
    try:
        units.conversion(unit, si)
    except ValueError:
        return False
    return True


def _item(row: Signal, value: str | None, unit: str | None, si: str | None, shape: str, *, nulls: bool) -> str:
    """The expression for one element of a row without a function."""
    if value is None:
        return "None"
    if shape in {"bits", "bool"}:
        return f"(None if {value} is None else {value} != 0)" if nulls else f"{value} != 0"
    if shape == "int" or si is None:
        return value
    if unit is None and si != "1":
        raise ValueError(f"{row.key} is in {si}, but its source has no unit")
    scaled = _scaled(value, unit or "1", si)
    return f"(None if {value} is None else {scaled})" if nulls and scaled != value else scaled


def _scaled(value: str, unit: str, si: str) -> str:
    found = units.conversion(unit, si)
    text = value if found.scale == 1.0 else f"{value} * {found.scale!r}"
    return text if found.offset == 0.0 else f"{text} + {found.offset!r}"
