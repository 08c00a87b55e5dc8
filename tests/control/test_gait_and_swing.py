"""Gait clock, swing path and footholds."""

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.control import GaitSettings, gait
from agile_jax.control.swing import foothold, forward_reach, swing_path
from agile_jax.robot import RobotSettings, leg_inverse_kinematics, load_robot

SETTINGS = GaitSettings()


def test_trot_moves_diagonal_legs_together_and_stands_for_its_duty():
    times = jnp.linspace(0, 10 * SETTINGS.period, 10_000, endpoint=False)
    stands = np.array(gait.stance(SETTINGS, times))
    np.testing.assert_array_equal(stands[:, 0], stands[:, 3])
    np.testing.assert_array_equal(stands[:, 1], stands[:, 2])
    np.testing.assert_allclose(stands.mean(0), SETTINGS.duty, atol=2e-3)
    assert stands.any(-1).all()  # duty above one half: never all feet in the air


def test_swing_progress_runs_from_0_to_1_in_the_swing_duration():
    begin = SETTINGS.period * SETTINGS.duty
    times = jnp.array([begin, begin + gait.swing_duration(SETTINGS) / 2, SETTINGS.period - 1e-6])
    np.testing.assert_allclose(gait.swing_progress(SETTINGS, times)[:, 0], [0, 0.5, 1], atol=1e-4)


def test_swing_path_starts_and_ends_at_rest_and_reaches_its_apex():
    lift_off, touch_down = jnp.array([0.1, -0.1, 0.02]), jnp.array([0.25, -0.12, 0.03])
    height, duration = jnp.float32(0.05), 0.16

    def path(progress):
        return swing_path(lift_off, touch_down, height, progress, duration)

    for progress, expected in ((0.0, lift_off), (1.0, touch_down)):
        position, velocity = path(jnp.float32(progress))
        np.testing.assert_allclose(position, expected, atol=1e-6)
        np.testing.assert_allclose(velocity, 0, atol=1e-5)
    assert np.isclose(path(jnp.float32(0.5))[0][2], 0.03 + 0.05)


def test_swing_velocity_is_the_derivative_of_position():
    lift_off, touch_down = jnp.array([0.1, -0.1, 0.02]), jnp.array([0.25, -0.12, 0.03])
    duration = 0.16

    def position(progress):
        return swing_path(lift_off, touch_down, jnp.float32(0.05), progress, duration)[0]

    for progress in (0.1, 0.4, 0.6, 0.9):
        expected = jax.jacfwd(position)(jnp.float32(progress)) / duration
        velocity = swing_path(lift_off, touch_down, jnp.float32(0.05), jnp.float32(progress), duration)[1]
        np.testing.assert_allclose(velocity, expected, atol=1e-5)


def test_foothold_is_symmetric_and_catches_a_push():
    hips = jnp.zeros((4, 2))
    still = jnp.zeros(2)
    height = jnp.float32(0.27)
    np.testing.assert_allclose(foothold(hips, still, still, jnp.float32(0), height, 0.2, 0.03), 0)
    # At the wanted velocity the foot lands half a stance ahead; pushed, further in the push's direction.
    v = jnp.array([0.5, 0.0])
    np.testing.assert_allclose(foothold(hips, v, v, jnp.float32(0), height, 0.2, 0.03)[0], [0.05, 0], atol=1e-6)
    pushed = foothold(hips, jnp.array([0.0, 0.4]), still, jnp.float32(0), height, 0.2, 0.03)
    np.testing.assert_allclose(pushed[0], [0, 0.04 + 0.012], atol=1e-6)
    # Turning left at speed, the feet land to the right: v x w.
    assert foothold(hips, v, v, jnp.float32(1), height, 0.2, 0.03)[0, 1] < 0


def test_forward_reach_puts_the_knee_at_its_clearance():
    """Forward kinematics of a leg whose foot stands at the reach: the knee is exactly at the clearance."""
    robot = load_robot(RobotSettings())
    for height in (0.16, 0.18, 0.2):
        reach = forward_reach(jnp.float32(height), robot.thigh_length, robot.calf_length, robot.foot_radius, 0.035)
        foot = robot.hip_pos_base + np.stack([np.full(4, reach), robot.abad_offset, np.full(4, 0.02 - height)], -1)
        joints = np.array(leg_inverse_kinematics(robot, jnp.asarray(foot, jnp.float32))).reshape(4, 3)
        knee_height = height - robot.thigh_length * np.cos(joints[:, 1])
        np.testing.assert_allclose(knee_height, 0.035, atol=1e-3)
