"""Units: every known one converts to SI, and nothing converts to another quantity."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.units import conversion, is_known, shares


@pytest.mark.parametrize(
    ("unit", "si", "raw", "value"),
    [
        ("deg", "rad", 180.0, math.pi),
        ("rad", "rad", 2.5, 2.5),
        ("mm", "m", 1500.0, 1.5),
        ("degC", "K", 25.0, 298.15),
        ("degC", "K", -273.15, 0.0),
        ("mA", "A", 250.0, 0.25),
        ("ms", "s", 8.0, 0.008),
        ("us", "s", 8.0, 8e-6),
        ("Nm", "N·m", 3.0, 3.0),
        ("mm/s", "m/s", 250.0, 0.25),
        ("deg/s", "rad/s", 90.0, math.pi / 2),
        ("deg/s^2", "rad/s²", 90.0, math.pi / 2),
        ("%", "1", 50.0, 0.5),
    ],
)
def test_a_unit_converts_to_si(unit: str, si: str, raw: float, value: float) -> None:
    assert conversion(unit, si)(raw) == pytest.approx(value, rel=1e-15, abs=1e-12)


def test_a_unit_does_not_convert_to_another_quantity() -> None:
    with pytest.raises(ValueError, match="unit 'deg' converts to 'rad', not to 'm'"):
        conversion("deg", "m")


def test_an_unknown_unit_is_named_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="unit 'furlong' is unknown; known are %, 1, A"):
        conversion("furlong", "m")


@pytest.mark.parametrize(("unit", "known"), [("mm|deg", True), ("deg", True), ("mm|furlong", False), ("", False)])
def test_a_pose_is_known_by_both_parts(unit: str, *, known: bool) -> None:
    assert is_known(unit) is known


def test_the_values_of_an_array_have_equal_shares_of_its_units() -> None:
    assert shares("deg", "rad", 2) == [("deg", "rad")] * 2
    assert shares("mm/s|deg/s", "m/s, rad/s", 4) == [("mm/s", "m/s")] * 2 + [("deg/s", "rad/s")] * 2


@pytest.mark.parametrize(("unit", "si", "count"), [("mm|deg", "m", 6), ("mm", "m, rad", 6), ("mm|deg", "m, rad", 5)])
def test_units_that_do_not_share_an_array_are_refused(unit: str, si: str, count: int) -> None:
    with pytest.raises(ValueError, match=f"{count} values in '.*' do not become an array in '{si}'"):
        shares(unit, si, count)


@given(st.floats(-1e6, 1e6))
def test_degrees_agree_with_the_standard_library(angle: float) -> None:
    assert conversion("deg", "rad")(angle) == pytest.approx(math.radians(angle), rel=1e-15, abs=1e-300)
