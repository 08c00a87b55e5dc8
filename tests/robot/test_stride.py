"""The window of a foot under a crouching trunk, against the robot's kinematics and formulas."""

import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.robot import (
    RobotSettings,
    leg_inverse_kinematics,
    link_poses,
    load_robot,
    lowest_height,
    overshoot,
    stride_table,
)
from agile_jax.robot.stride import FLOOR_CLEARANCE

A1 = load_robot(RobotSettings())
TABLE = stride_table(A1)
LENGTH = A1.thigh_length + A1.calf_length
THIGH = [
    (-0.0075, 0.0, 0.0225),
    (-0.0075, -0.2, 0.0225),
    (-0.0155, 0.0, 0.0195),
    (-0.0155, -0.17, 0.0195),
]  # x, z, radius
CALF, FOOT = [(0.0102, 0.0, 0.02), (0.0102, -0.18, 0.02)], (0.0, -0.2, 0.02)


def test_shape_of_the_a1_is_that_of_its_file():
    assert A1.shape.trunk_top == pytest.approx(0.058)
    assert A1.shape.trunk_bottom == pytest.approx(0.058)
    np.testing.assert_allclose(np.sort(A1.shape.thigh, 0), np.sort(np.array(THIGH), 0), atol=1e-9)
    np.testing.assert_allclose(np.sort(A1.shape.calf, 0), np.sort(np.array([*CALF, FOOT]), 0), atol=1e-9)


@pytest.mark.parametrize("height", [0.13, 0.15, 0.17])
def test_ends_of_the_window_touch_the_level_of_the_trunk_and_the_clearance_of_the_floor(height: float):
    """By the robot's own kinematics, for the capsules of thigh and calf."""

    def heights(x: float, link: int, points: list[tuple[float, float, float]]) -> np.ndarray:
        feet = A1.hip_pos_base + np.stack([np.full(4, x), A1.abad_offset, np.full(4, A1.foot_radius - height)], -1)
        poses = link_poses(A1, leg_inverse_kinematics(A1, jnp.asarray(feet, jnp.float32)))
        px, pz, _ = np.array(points).T
        return (poses.pos[link] + np.stack([px, 0 * px, pz], -1) @ np.asarray(poses.rotation[link]).T)[:, 2]

    rear, front = (np.interp(height, TABLE.height, ends) for ends in TABLE[1:])
    tops = [(heights(rear, link, points) + np.array(points)[:, 2]).max() for link, points in ((2, THIGH), (3, CALF))]
    assert max(tops) == pytest.approx(A1.shape.trunk_top, abs=2e-3)
    lowest = (heights(front, 2, THIGH) - np.array(THIGH)[:, 2]).min()
    assert height + lowest == pytest.approx(FLOOR_CLEARANCE * LENGTH, abs=2e-3)


def test_window_grows_with_the_height_until_the_knee_no_longer_binds():
    low = TABLE.height < 0.19
    assert (np.diff(TABLE.front[low]) >= 0).all()
    assert (np.diff(TABLE.rear[low]) <= 0).all()


def test_lowest_height_is_where_the_folded_knee_leaves_room_for_a_step():
    folded = np.sqrt(0.2**2 + 0.2**2 + 2 * 0.2 * 0.2 * np.cos(2.69653))
    assert lowest_height(A1) == pytest.approx(folded + 0.02 + 0.008 + 0.006, abs=1e-6)
    assert (TABLE.front > TABLE.rear).all()


def test_overshoot_is_the_largest_lead_over_the_landing_place():
    s = np.linspace(0, 1, 100_001)
    for duty in (0.5, 0.55, 0.8):
        assert overshoot(duty) == pytest.approx((s * s * (3 - 2 * s) - (1 - duty) * s).max() - duty, abs=1e-9)


def test_a_robot_twice_as_large_has_a_window_twice_as_large():
    """The table is derived from the robot: no length of the A1 is in it."""
    shape = A1.shape._replace(
        trunk_top=2 * A1.shape.trunk_top,
        trunk_bottom=2 * A1.shape.trunk_bottom,
        thigh=2 * A1.shape.thigh,
        calf=2 * A1.shape.calf,
    )
    lengths = {name: 2 * getattr(A1, name) for name in ("thigh_length", "calf_length", "foot_radius")}
    for mine, twice in zip(TABLE, stride_table(A1._replace(shape=shape, **lengths)), strict=True):
        np.testing.assert_allclose(2 * mine, twice, atol=4e-3)
