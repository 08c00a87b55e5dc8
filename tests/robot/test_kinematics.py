"""Kinematics and composite inertia against MuJoCo, at random postures."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agile_jax.robot import (
    LEG_NAMES,
    RobotSettings,
    build_mujoco_model,
    composite_inertia,
    leg_forward_kinematics,
    leg_inverse_kinematics,
    leg_jacobian,
    load_robot,
    robot_state,
    standing_qpos,
)
from agile_jax.scene import SceneSettings, make_scene

MODEL = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), 0.002)
ROBOT = load_robot(RobotSettings())
POSTURES = np.random.default_rng(0).uniform(ROBOT.joint_lower, ROBOT.joint_upper, (50, 12))

forward = jax.jit(jax.vmap(lambda q: leg_forward_kinematics(ROBOT, q)))
inverse = jax.jit(jax.vmap(lambda p: leg_inverse_kinematics(ROBOT, p)))


def mujoco_data(joint_pos, base_quat=(1.0, 0.0, 0.0, 0.0)) -> mujoco.MjData:
    data = mujoco.MjData(MODEL)
    data.qpos[:] = [0.0, 0.0, 0.0, *base_quat, *joint_pos]
    mujoco.mj_forward(MODEL, data)
    return data


def test_feet():
    feet = forward(POSTURES)
    for posture, expected in zip(POSTURES, feet, strict=True):
        data = mujoco_data(posture)
        actual = np.stack([data.geom(f"{leg}_foot").xpos for leg in LEG_NAMES])
        np.testing.assert_allclose(expected, actual, atol=1e-6)


def test_jacobian():
    jacobians = jax.jit(jax.vmap(lambda q: leg_jacobian(ROBOT, q)))(POSTURES)
    for posture, jacobian in zip(POSTURES, jacobians, strict=True):
        data = mujoco_data(posture)
        for leg, name in enumerate(LEG_NAMES):
            full = np.zeros((3, MODEL.nv))
            mujoco.mj_jacGeom(MODEL, data, full, None, MODEL.geom(f"{name}_foot").id)
            np.testing.assert_allclose(jacobian[leg], full[:, 6 + 3 * leg : 9 + 3 * leg], atol=1e-6)
            full[:, 6 + 3 * leg : 9 + 3 * leg] = 0
            assert not full[:, 6:].any()  # a foot depends on its own leg only


def test_composite_inertia():
    results = jax.jit(jax.vmap(lambda q: composite_inertia(ROBOT, q)))(POSTURES)
    for posture, mass, com, inertia in zip(POSTURES, *results, strict=True):
        # Seen in the base's own frame, the answer must not depend on how the base is turned.
        data = mujoco_data(posture, base_quat=(0.5, -0.5, 0.5, 0.5))
        matrix = np.zeros((MODEL.nv, MODEL.nv))
        mujoco.mj_fullM(MODEL, data, matrix)
        base = data.xmat[1].reshape(3, 3)
        actual_com = base.T @ (data.subtree_com[1] - data.xpos[1])
        shift = matrix[0, 0] * (actual_com @ actual_com * np.eye(3) - np.outer(actual_com, actual_com))
        assert mass == pytest.approx(matrix[0, 0], rel=1e-6)
        np.testing.assert_allclose(com, actual_com, atol=1e-6)
        np.testing.assert_allclose(inertia, matrix[3:6, 3:6] - shift, atol=2e-6)


def test_composite_inertia_at_home_is_the_known_one():
    _, com, inertia = composite_inertia(ROBOT, jnp.asarray(ROBOT.home_joint_pos))
    np.testing.assert_allclose(np.diag(inertia), [0.1416, 0.3675, 0.3995], rtol=5e-3)
    assert inertia[0, 2] == pytest.approx(-0.0097, abs=1e-4)
    np.testing.assert_allclose(com, [-0.0112, 0.0016, -0.0197], atol=1.5e-4)


def test_inverse_undoes_forward():
    """On the branch with bent-back knees and the feet below the hips, joint positions are unique."""
    generator = np.random.default_rng(1)
    lower = np.tile([-0.7, 0.3, -2.6], 4)
    upper = np.tile([0.7, 1.6, -0.95], 4)
    postures = generator.uniform(lower, upper, (200, 12))
    np.testing.assert_allclose(inverse(forward(postures)), postures, atol=2e-4)


def test_inverse_of_a_place_out_of_reach_stretches_towards_it():
    shoulder = ROBOT.hip_pos_base + ROBOT.abad_offset[:, None] * np.array([0.0, 1.0, 0.0])
    direction = np.array([0.3, 0.0, -1.0]) / np.hypot(0.3, 1.0)
    joint_pos = np.asarray(inverse((shoulder + 2.0 * direction)[None])[0])
    reached = forward(joint_pos[None])[0] - shoulder
    reach = np.sqrt(2 * 0.2**2 * (1 + np.cos(0.916298)))  # the knee's limit keeps the leg from straightening
    np.testing.assert_allclose(reached, np.tile(reach * direction, (4, 1)), atol=1e-5)


def test_inverse_is_finite_and_within_limits_everywhere():
    places = np.random.default_rng(2).normal(0.0, 0.4, (500, 4, 3))
    places[0] = ROBOT.hip_pos_base  # the singular place
    joint_pos = np.asarray(inverse(places))
    assert np.isfinite(joint_pos).all()
    assert (joint_pos >= ROBOT.joint_lower - 1e-6).all()
    assert (joint_pos <= ROBOT.joint_upper + 1e-6).all()


@pytest.mark.parametrize("pose", [[0.0, 0.0, 0.28, 0.0], [1.0, -2.0, 0.17, 2.0], [0.3, 0.1, 0.32, -3.0]])
def test_standing_puts_the_feet_on_the_floor_under_the_hips(pose):
    data = mujoco.MjData(MODEL)
    data.qpos[:] = standing_qpos(ROBOT, jnp.array(pose))
    mujoco.mj_forward(MODEL, data)
    c, s = np.cos(pose[3]), np.sin(pose[3])
    yaw = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(data.xmat[1].reshape(3, 3), yaw, atol=1e-6)
    for leg, name in enumerate(LEG_NAMES):
        under = np.array(pose[:3]) + yaw @ (ROBOT.hip_pos_base[leg] + [0.0, ROBOT.abad_offset[leg], 0.0])
        np.testing.assert_allclose(data.geom(f"{name}_foot").xpos, [*under[:2], 0.02], atol=1e-5)


def test_robot_state_follows_mujocos_conventions():
    """Linear velocity in the world, angular velocity in the base: compared with MuJoCo's own object velocity."""
    generator = np.random.default_rng(3)
    data = mujoco_data(POSTURES[0], base_quat=generator.normal(size=4))
    mujoco.mj_normalizeQuat(MODEL, data.qpos)
    data.qvel[:] = generator.normal(size=18)
    mujoco.mj_forward(MODEL, data)
    state = robot_state(data.qpos, data.qvel)
    world, local = np.zeros(6), np.zeros(6)
    mujoco.mj_objectVelocity(MODEL, data, mujoco.mjtObj.mjOBJ_XBODY, 1, world, 0)
    mujoco.mj_objectVelocity(MODEL, data, mujoco.mjtObj.mjOBJ_XBODY, 1, local, 1)
    np.testing.assert_allclose(state.base_lin_vel_world, world[3:], atol=1e-12)
    np.testing.assert_allclose(state.base_ang_vel_base, local[:3], atol=1e-12)
    np.testing.assert_array_equal(state.joint_pos, data.qpos[7:])
    np.testing.assert_array_equal(state.joint_vel, data.qvel[6:])
