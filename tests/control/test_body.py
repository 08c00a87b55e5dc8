"""The inertia that the feet feel, and the loops that depend on it, against MuJoCo's mass matrix."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agile_jax.control import ControlSettings, Reference
from agile_jax.control.body import slowed, turning_inertia
from agile_jax.control.joint_model import top_speed
from agile_jax.robot import (
    RobotSettings,
    build_mujoco_model,
    composite_inertia,
    leg_forward_kinematics,
    leg_inverse_kinematics,
    leg_jacobian,
    load_robot,
)
from agile_jax.scene import SceneSettings, make_scene

ROBOT = load_robot(RobotSettings())
MODEL = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), 0.002)


def postures(count: int) -> np.ndarray:
    """Joint positions from a crouch to nearly straight legs, the feet about their hips; shape (count, 12)."""
    rng = np.random.default_rng(0)
    shift = np.stack([rng.uniform(-0.1, 0.06, (count, 4)), rng.uniform(-0.04, 0.04, (count, 4))], -1)
    below = np.repeat(rng.uniform(-0.31, -0.11, (count, 1)), 4, 1)[..., None]
    hips = ROBOT.hip_pos_base + np.stack([np.zeros(4), ROBOT.abad_offset, np.zeros(4)], -1)
    feet = hips + np.concatenate([shift, below], -1)
    return np.array([leg_inverse_kinematics(ROBOT, np.float32(places)) for places in feet])


def mass_matrix(joint_pos: np.ndarray, armature: float) -> np.ndarray:
    data, matrix = mujoco.MjData(MODEL), np.zeros((18, 18))
    data.qpos[:] = np.r_[0, 0, 5.0, 1, 0, 0, 0, joint_pos]
    mujoco.mj_forward(MODEL, data)
    for row, unit in zip(matrix, np.eye(18), strict=True):
        mujoco.mj_mulM(MODEL, data, row, unit)
    return matrix + np.diag(np.r_[np.zeros(6), np.full(12, armature - 0.01)])


@pytest.mark.parametrize("armature", [0.0, 0.01, 0.03])
def test_turning_inertia_is_that_of_the_mass_matrix_with_the_feet_held(armature: float) -> None:
    robot = ROBOT._replace(joint_armature=np.full(12, armature))
    for joint_pos in postures(5):
        feet = np.array(leg_forward_kinematics(ROBOT, joint_pos))
        center = np.array(composite_inertia(ROBOT, joint_pos)[1])
        jacobian = np.array(leg_jacobian(ROBOT, joint_pos))
        ways = np.zeros((18, 3))  # of all coordinates, for a turn about each axis through the centre of mass
        for i, axis in enumerate(np.eye(3)):
            ways[:3, i], ways[3:6, i] = -np.cross(axis, center), axis
            ways[6:, i] = np.concatenate(
                [np.linalg.solve(jacobian[leg], -np.cross(axis, feet[leg] - center)) for leg in range(4)]
            )
        expected = ways.T @ mass_matrix(joint_pos, armature) @ ways
        found = turning_inertia(robot, jnp.asarray(joint_pos), jnp.asarray(center))
        np.testing.assert_allclose(found, expected, rtol=0.06, atol=3e-3)  # the inverse is damped


def test_without_rotors_a_rigid_robot_would_roll_four_times_as_heavily() -> None:
    """Its believed inertia over the true one is the gain of the MPC's loop: at 50 Hz, three are too much."""
    robot = ROBOT._replace(joint_armature=np.zeros(12))
    posture = jnp.asarray(ROBOT.home_joint_pos, jnp.float32)
    _, center, rigid = composite_inertia(ROBOT, posture)
    assert rigid[0, 0] > 3.5 * turning_inertia(robot, posture, center)[0, 0]


@pytest.mark.parametrize("damping", [0.0, 0.5, 1.0, 2.0])
def test_swinging_legs_are_stable_without_rotors_whatever_the_true_damping(damping: float) -> None:
    """The sampled loop of a leg under a held trunk: joint feedback and, once learned, all of the damping fed back.

    MuJoCo takes damping implicitly, so a step is (M + dt D) (v' - v) = dt (tau - D v), q' = q + dt v'.
    """
    settings, dt = ControlSettings(), ControlSettings().control_dt
    for joint_pos in postures(30):
        for leg in range(4):
            rows = slice(6 + 3 * leg, 9 + 3 * leg)
            inertia, passive = mass_matrix(joint_pos, 0.0)[rows, rows], damping * np.diag(ROBOT.joint_damping[:3])
            inverse = np.linalg.inv(inertia + dt * passive)
            to_velocity = np.eye(3) + dt * inverse @ (-settings.swing_damping * np.eye(3))
            from_place = -dt * inverse * settings.swing_stiffness
            step = np.block([[np.eye(3) + dt * from_place, dt * to_velocity], [from_place, to_velocity]])
            assert np.abs(np.linalg.eigvals(step)).max() < 0.999


def test_joints_that_take_twice_the_torque_walk_half_as_fast_and_the_a1_as_it_did() -> None:
    heavy = ROBOT._replace(joint_damping=2 * ROBOT.joint_damping, joint_friction=np.zeros(12))
    light = ROBOT._replace(joint_friction=np.zeros(12))
    height, duty = jnp.float32(0.156), jnp.float32(0.55)
    assert top_speed(light, height, duty) == pytest.approx(2 * float(top_speed(heavy, height, duty)), rel=1e-5)
    assert top_speed(ROBOT, height, duty) > 1.3  # what is asked of it under a table is 1 m/s
    free = ROBOT._replace(joint_damping=np.zeros(12))
    assert top_speed(free, height, duty) > 100.0
    s = np.linspace(0, 1, 2001)
    rms = np.sqrt(np.mean((6 * s * (1 - s) / 0.45 - 1) ** 2))  # of the foot over the speed of the trunk
    turning = 33.5 / 4.0
    assert top_speed(heavy, height, duty) == pytest.approx(turning * (0.156 - 0.02) / rms, rel=1e-3)


def test_a_slowed_reference_goes_the_same_way() -> None:
    pose = jnp.array([1.0, 0.5, 0.2, 0.1])
    velocities = jnp.tile(jnp.array([0.8, 0.6, -0.2, 0.4]), (5, 1))
    poses = pose + 0.03 * jnp.arange(1.0, 6.0)[:, None] * velocities
    reference = Reference(pose, velocities[0], poses, velocities)
    half = slowed(reference, jnp.float32(0.5))
    np.testing.assert_allclose(half.velocities, velocities / 2, rtol=1e-6)
    np.testing.assert_allclose(half.poses - pose, (poses - pose) / 2, rtol=1e-4, atol=1e-6)
    for before, after in zip(reference, slowed(reference, jnp.float32(2.0)), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-6)
