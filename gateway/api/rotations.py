"""Rotations: from the three numbers that vendors give to the model's unit quaternions."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, isinf, sin
from typing import Literal

from gateway.api.model import Pose

Rotation = Literal["rpy_fixed_xyz", "rotation_vector"]


def quaternion_from_rpy(rx: float, ry: float, rz: float) -> list[float | None]:
    """Convert roll-pitch-yaw to a unit quaternion: R = Rz(rz)·Ry(ry)·Rx(rx).

    The same rotation is called Z-Y'-X'' Euler, or fixed X, Y, Z.

    Args:
        rx: Roll, rad, about the fixed X axis of the base.
        ry: Pitch, rad, about the fixed Y axis.
        rz: Yaw, rad, about the fixed Z axis.

    Returns:
        Shape (4,), (x, y, z, w), w >= 0.
    """
    rx, ry, rz = rx * 0.5, ry * 0.5, rz * 0.5
    cx, cy, cz, sx, sy, sz = cos(rx), cos(ry), cos(rz), sin(rx), sin(ry), sin(rz)
    cc, ss, cs, sc = cy * cz, sy * sz, cy * sz, sy * cz
    w = cx * cc + sx * ss
    if w >= 0:
        return [sx * cc - cx * ss, cx * sc + sx * cs, cx * cs - sx * sc, w]
    return [cx * ss - sx * cc, -cx * sc - sx * cs, sx * sc - cx * cs, -w]


def pose_from_rpy(x: float, y: float, z: float, rx: float, ry: float, rz: float) -> Pose:
    """Make a pose of a position in m and roll-pitch-yaw in rad about the fixed axes."""
    return Pose([x, y, z], quaternion_from_rpy(rx, ry, rz))


def quaternion_from_rotation_vector(rx: float, ry: float, rz: float) -> list[float | None] | None:
    """Convert a rotation vector (axis times angle) to a unit quaternion.

    Args:
        rx: x of the vector, rad: its direction is the axis, its length the angle.
        ry: y, rad.
        rz: z, rad.

    Returns:
        Shape (4,), (x, y, z, w), w >= 0; None for a vector that is too long to be a rotation.
    """
    angle = hypot(rx, ry, rz)
    if isinf(angle):
        return None
    w = cos(angle * 0.5)
    scale = sin(angle * 0.5) / angle if angle else 0.5
    return [rx * scale, ry * scale, rz * scale, w] if w >= 0 else [-rx * scale, -ry * scale, -rz * scale, -w]


# How an orientation is made of three numbers in rad, by the rotation that a signal row states.
QUATERNION_FROM: dict[Rotation, Callable[[float, float, float], list[float | None] | None]] = {
    "rpy_fixed_xyz": quaternion_from_rpy,
    "rotation_vector": quaternion_from_rotation_vector,
}
