"""Rotations, against products of rotation matrices that numpy multiplies."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.api.rotations import (
    QUATERNION_FROM,
    pose_from_rpy,
    quaternion_from_rotation_vector,
    quaternion_from_rpy,
)

Matrix = npt.NDArray[np.float64]


def about(axis: int, angle: float) -> Matrix:
    """The matrix of a rotation about one axis."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = math.cos(angle)
    matrix[second, first] = math.sin(angle)
    matrix[first, second] = -math.sin(angle)
    return matrix


def matrix_of(quaternion: list[float | None]) -> Matrix:
    """The matrix of a unit quaternion (x, y, z, w), column by column: q · e · q*."""
    vector, w = np.array(quaternion[:3], dtype=float), float(quaternion[3] or 0.0)
    turned = [e + 2 * w * np.cross(vector, e) + 2 * np.cross(vector, np.cross(vector, e)) for e in np.eye(3)]
    return np.array(turned).T


ANGLES = st.floats(-2 * math.pi, 2 * math.pi)


@given(ANGLES, ANGLES, ANGLES)
def test_rpy_is_rz_times_ry_times_rx(rx: float, ry: float, rz: float) -> None:
    expected = about(2, rz) @ about(1, ry) @ about(0, rx)
    quaternion = quaternion_from_rpy(rx, ry, rz)
    np.testing.assert_allclose(matrix_of(quaternion), expected, atol=1e-12)
    assert math.hypot(*(part for part in quaternion if part is not None)) == pytest.approx(1)
    assert (quaternion[3] or 0.0) >= 0


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    half = math.sqrt(0.5)
    assert quaternion_from_rpy(0, 0, math.pi / 2) == pytest.approx([0, 0, half, half])


def test_a_quaternion_with_negative_w_is_turned_over() -> None:
    assert quaternion_from_rpy(0, 0, 1.5 * math.pi) == pytest.approx([0, 0, -math.sqrt(0.5), math.sqrt(0.5)])


def test_the_order_of_the_angles_matters() -> None:
    assert quaternion_from_rpy(0.5, 0.25, -0.75) != pytest.approx(quaternion_from_rpy(-0.75, 0.25, 0.5))


def test_a_pose_keeps_its_position() -> None:
    assert pose_from_rpy(1, 2, 3, 0, 0, 0).position == [1, 2, 3]
    assert pose_from_rpy(1, 2, 3, 0, 0, 0).orientation == [0, 0, 0, 1]
    assert set(QUATERNION_FROM) == {"rpy_fixed_xyz", "rotation_vector"}


@given(ANGLES, ANGLES, ANGLES)
def test_a_rotation_vector_is_the_limit_of_many_small_turns(rx: float, ry: float, rz: float) -> None:
    steps = 1 << 30  # squared 30 times: (1 + W / n) ** n, W the cross-product matrix of the vector
    small = np.eye(3) + np.array([[0, -rz, ry], [rz, 0, -rx], [-ry, rx, 0]]) / steps
    for _ in range(30):
        small = small @ small
    quaternion = quaternion_from_rotation_vector(rx, ry, rz) or []
    np.testing.assert_allclose(matrix_of(quaternion), small, atol=1e-4)
    assert math.hypot(*(part for part in quaternion if part is not None)) == pytest.approx(1)
    assert (quaternion[3] or 0.0) >= 0


@pytest.mark.parametrize("axis", range(3))
def test_a_rotation_vector_along_an_axis_turns_about_it(axis: int) -> None:
    for angle in (-4.0, -0.5, 1e-9, 0.0, 2.0, math.pi, 5.0):
        vector = [angle if place == axis else 0.0 for place in range(3)]
        found = quaternion_from_rotation_vector(vector[0], vector[1], vector[2]) or []
        np.testing.assert_allclose(matrix_of(found), about(axis, angle), atol=1e-12)


def test_no_rotation_at_all_is_the_unit_quaternion() -> None:
    assert quaternion_from_rotation_vector(0, 0, 0) == [0, 0, 0, 1]


def test_a_vector_too_long_to_be_a_rotation_has_no_orientation() -> None:
    assert quaternion_from_rotation_vector(1.7e308, -1.7e308, 0) is None
    assert quaternion_from_rotation_vector(5e-324, 0, 0) == pytest.approx([0, 0, 0, 1])
