"""A smooth six-joint motion: where a plausible cobot is, how fast, at what currents and temperatures.

Everything is a pure function of the place on the path, or of the time. No vendor's units: rad, m, A, K.
"""

from __future__ import annotations

from math import asin, atan2, cos, pi, sin, tau

import msgspec

from gateway.api.units import ZERO_CELSIUS_K

Six = tuple[float, float, float, float, float, float]
Vector = tuple[float, float, float]

# Seconds of one cycle of the path at full speed.
CYCLE_S = 12.0

# joint -> (centre in rad, amplitude in rad, swings a cycle, phase in rad)
_SWINGS = (
    (0.00, 0.90, 1, 0.0),
    (-1.20, 0.35, 2, 0.7),
    (1.45, 0.45, 2, 2.1),
    (-1.60, 0.30, 1, 1.3),
    (-1.50, 0.25, 3, 0.4),
    (0.30, 1.10, 1, 2.6),
)

# Denavit-Hartenberg rows of a small cobot, base -> flange: (d in m, a in m, cos(alpha), sin(alpha))
_LINKS = (
    (0.0892, 0.0, 0.0, 1.0),
    (0.0, -0.425, 1.0, 0.0),
    (0.0, -0.3922, 1.0, 0.0),
    (0.1092, 0.0, 0.0, 1.0),
    (0.0947, 0.0, 0.0, -1.0),
    (0.0823, 0.0, 1.0, 0.0),
)

# The servo follows its target this much later.
_SERVO_LAG_S = 0.008
# joint -> (holding current in A, A for each rad/s)
_CURRENTS = ((0.3, 1.1), (2.4, 1.6), (1.7, 1.2), (0.5, 0.8), (0.4, 0.6), (0.2, 0.4))
_WARM_K = (ZERO_CELSIUS_K + 33, ZERO_CELSIUS_K + 37, ZERO_CELSIUS_K + 36) * 2
_DRIFT_K, _DRIFT_S = 4.0, 900.0


class ArmPose(msgspec.Struct, frozen=True, gc=False):
    """Where the TCP is.

    Attributes:
        position: x, y, z in m, in the base reference.
        rpy: rx, ry, rz in rad, R = Rz(rz)·Ry(ry)·Rx(rx).
        speed: Of the TCP, m/s.
    """

    position: Vector
    rpy: Vector
    speed: float


def target(place_s: float, rate: float) -> tuple[Six, Six]:
    """Return the target positions (rad) and velocities (rad/s).

    Args:
        place_s: The place on the path, as seconds at full speed; the path closes after `CYCLE_S`.
        rate: How fast the place moves on: 1 is full speed.
    """
    turn = place_s * (tau / CYCLE_S)
    speed = rate * (tau / CYCLE_S)
    angles = [turn * swings + phase for _, _, swings, phase in _SWINGS]
    p = [row[0] + row[1] * sin(angle) for row, angle in zip(_SWINGS, angles, strict=True)]
    v = [speed * row[1] * row[2] * cos(angle) for row, angle in zip(_SWINGS, angles, strict=True)]
    return (p[0], p[1], p[2], p[3], p[4], p[5]), (v[0], v[1], v[2], v[3], v[4], v[5])


def measured(position: Six, velocity: Six) -> Six:
    """Return where the joints are, in rad: a little behind their target."""
    a, b, c, d, e, f = position
    p, q, r, s, t, u = velocity
    lag = _SERVO_LAG_S
    return a - lag * p, b - lag * q, c - lag * r, d - lag * s, e - lag * t, f - lag * u


def forward(position: Six, velocity: Six) -> ArmPose:
    """Solve the forward kinematics: joints in rad and rad/s to the pose and speed of the TCP."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    px = py = pz = 0.0
    vx = vy = vz = wx = wy = wz = 0.0
    for angle, rate, (d, a, ca, sa) in zip(position, velocity, _LINKS, strict=True):
        # The joint turns about the z axis that its predecessor left: all that follows moves with it.
        wx, wy, wz = wx + rate * zx, wy + rate * zy, wz + rate * zz
        c, s = cos(angle), sin(angle)
        nx, ny, nz = c * xx + s * yx, c * xy + s * yy, c * xz + s * yz
        bx, by, bz = c * yx - s * xx, c * yy - s * xy, c * yz - s * xz
        lx, ly, lz = d * zx + a * nx, d * zy + a * ny, d * zz + a * nz
        px, py, pz = px + lx, py + ly, pz + lz
        vx, vy, vz = vx + wy * lz - wz * ly, vy + wz * lx - wx * lz, vz + wx * ly - wy * lx
        xx, xy, xz = nx, ny, nz
        yx, yy, yz, zx, zy, zz = (
            ca * bx + sa * zx,
            ca * by + sa * zy,
            ca * bz + sa * zz,
            ca * zx - sa * bx,
            ca * zy - sa * by,
            ca * zz - sa * bz,
        )
    rpy = (atan2(yz, zz), asin(max(-1.0, min(1.0, -xz))), atan2(xy, xx))
    return ArmPose((px, py, pz), rpy, (vx * vx + vy * vy + vz * vz) ** 0.5)


def currents(position: Six, velocity: Six) -> Six:
    """Return the joint currents in A: holding the arm against gravity, and moving it."""
    i = [
        hold * cos(angle) + drive * rate
        for (hold, drive), angle, rate in zip(_CURRENTS, position, velocity, strict=True)
    ]
    return i[0], i[1], i[2], i[3], i[4], i[5]


def temperatures(time_s: float) -> Six:
    """Return the joint temperatures in K, which drift by a few degrees in a quarter of an hour."""
    turn = time_s * (tau / _DRIFT_S)
    k = [warm + _DRIFT_K * sin(turn + joint * pi / 5) for joint, warm in enumerate(_WARM_K)]
    return k[0], k[1], k[2], k[3], k[4], k[5]
