"""The motion is smooth, and the pose is that of the joints."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest

from gateway.sim import motion


def rotation(rx: float, ry: float, rz: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    about_x = np.array([[1, 0, 0], [0, cos(rx), -sin(rx)], [0, sin(rx), cos(rx)]])
    about_y = np.array([[cos(ry), 0, sin(ry)], [0, 1, 0], [-sin(ry), 0, cos(ry)]])
    about_z = np.array([[cos(rz), -sin(rz), 0], [sin(rz), cos(rz), 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def test_the_path_closes_after_one_cycle() -> None:
    assert motion.target(motion.CYCLE_S, 1.0)[0] == pytest.approx(motion.target(0.0, 1.0)[0])


@pytest.mark.parametrize("place_s", [0.0, 1.7, 5.3, 11.9])
def test_the_velocity_is_the_derivative_of_the_position(place_s: float) -> None:
    step = 1e-6
    before, after = motion.target(place_s - step, 1.0)[0], motion.target(place_s + step, 1.0)[0]
    slope = [(b - a) / (2 * step) for a, b in zip(before, after, strict=True)]
    assert motion.target(place_s, 1.0)[1] == pytest.approx(slope, abs=1e-6)


def test_the_forward_kinematics_agree_with_matrices_multiplied_the_long_way() -> None:
    position, velocity = motion.target(3.3, 1.0)
    whole = np.eye(4)
    for angle, (d, a, ca, sa) in zip(position, motion._LINKS, strict=True):
        c, s = cos(angle), sin(angle)
        link = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        whole = whole @ np.array(link)
    pose = motion.forward(position, velocity)
    assert pose.position == pytest.approx(whole[:3, 3])
    assert rotation(*pose.rpy) == pytest.approx(whole[:3, :3])


def test_the_tcp_speed_is_that_of_its_position() -> None:
    step = 1e-5
    here, there = (motion.forward(*motion.target(place_s, 1.0)) for place_s in (2.0, 2.0 + step))
    distance = sum((b - a) ** 2 for a, b in zip(here.position, there.position, strict=True)) ** 0.5
    assert here.speed == pytest.approx(distance / step, rel=1e-3)


def test_the_arm_stays_inside_its_reach_and_above_the_table() -> None:
    poses = [motion.forward(*motion.target(tenth / 10, 1.0)) for tenth in range(120)]
    assert all(0.2 < sum(x * x for x in pose.position) ** 0.5 < 1.1 for pose in poses)
    assert all(pose.position[2] > 0 for pose in poses)


def test_the_measured_joints_follow_their_target_closely() -> None:
    target, velocity = motion.target(4.0, 1.0)
    measured = motion.measured(target, velocity)
    assert measured != target
    assert measured == pytest.approx(target, abs=pi / 180)


def test_temperatures_drift_slowly() -> None:
    first, later = motion.temperatures(0.0), motion.temperatures(1.0)
    assert first != later
    assert first == pytest.approx(later, abs=0.1)
