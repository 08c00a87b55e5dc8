"""Rows of torque against the torques that the controller commands, rows of position against inverse kinematics."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import ControlSettings, Reference
from agile_jax.control.body import measure, rotation_z
from agile_jax.control.mpc.leg_limits import joint_rows, nominal_motion, torque_rows
from agile_jax.control.torques import GUARD_MARGIN, GUARD_TIME, SwingTarget, limit_guard, whole_body_torque
from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot import RobotSettings, RobotState, leg_forward_kinematics, leg_inverse_kinematics, load_robot

ROBOT = load_robot(RobotSettings())
NODES, MARGIN = 3, 0.02


def random_state(seed: int) -> RobotState:
    rng = np.random.default_rng(seed)
    quat = np.array([np.cos(0.4), 0.05, -0.06, np.sin(0.4)]) + 0.02 * rng.normal(size=4)
    parts = (
        [0.3, -0.2, 0.22],
        quat / np.linalg.norm(quat),
        0.3 * rng.normal(size=3),
        0.3 * rng.normal(size=3),
        ROBOT.home_joint_pos + 0.15 * rng.normal(size=12),
        rng.normal(size=12),
    )
    return RobotState(*(jnp.asarray(part, jnp.float32) for part in parts))


def feet_world(state: RobotState) -> jax.Array:
    R = quaternion_to_matrix(state.base_quat, jnp)
    return state.base_pos + leg_forward_kinematics(ROBOT, state.joint_pos) @ R.T


def make_reference(state: RobotState, rng: np.random.Generator) -> Reference:
    pose = jnp.concatenate([state.base_pos, jnp.array([0.8])])
    poses = pose + jnp.asarray(np.cumsum(0.02 * rng.normal(size=(NODES, 4)), 0), jnp.float32)
    return Reference(pose, jnp.zeros(4), poses, jnp.asarray(rng.normal(size=(NODES, 4)), jnp.float32))


@pytest.mark.parametrize("seed", range(3))
def test_torque_rows_of_the_first_node_are_the_commanded_torques(seed: int):
    state, rng = random_state(seed), np.random.default_rng(seed)
    body, reference = measure(ROBOT, state), make_reference(state, rng)
    moved = jnp.concatenate([jnp.zeros((1, 4)), (reference.poses - reference.pose)[:-1]])
    support = jnp.broadcast_to(feet_world(state), (NODES, 4, 3))
    rows = torque_rows(ROBOT, state, body, reference, nominal_motion(ROBOT, body, moved, support))
    forces = jnp.asarray(rng.normal(size=(4, 3)) * 30, jnp.float32)
    still, zero = jnp.zeros((4, 3)), jnp.zeros(4)
    paths = SwingTarget(still, still, jnp.float32(0.05), zero, jnp.float32(0.1), zero, zero, zero)
    inertia, standing = np.zeros((4, 3, 3)), jnp.ones(4, bool)
    torque = whole_body_torque(
        ROBOT, ControlSettings(), inertia, state, body.R_world_base, standing, forces, reference.velocity, paths
    )
    images = jnp.einsum("lij,lj->li", rows.map[0], forces @ body.R_world_yaw).reshape(-1)
    feed_forward = (rows.upper[0] + rows.lower[0]).reshape(-1) / 2
    np.testing.assert_allclose(feed_forward - images, torque, atol=2e-3)
    np.testing.assert_allclose((rows.upper - rows.lower)[0].reshape(-1), 2 * ROBOT.torque_limit, rtol=1e-5)


def test_the_guard_pushes_joints_away_from_the_limits_that_they_near():
    middle = (ROBOT.joint_lower + ROBOT.joint_upper) / 2
    np.testing.assert_array_equal(limit_guard(ROBOT, jnp.asarray(middle), jnp.zeros(12), 60.0), 0.0)
    beyond, fast = 0.01, 5.0
    for side, limit in ((1.0, ROBOT.joint_lower), (-1.0, ROBOT.joint_upper)):
        past = limit_guard(ROBOT, jnp.asarray(limit - side * beyond), jnp.zeros(12), 60.0)
        near = limit_guard(ROBOT, jnp.asarray(limit + side * 0.05), jnp.full(12, -side * fast), 60.0)
        np.testing.assert_allclose(past, side * 300.0 * (GUARD_MARGIN + beyond), rtol=1e-3)
        np.testing.assert_allclose(near, side * 300.0 * (GUARD_MARGIN + GUARD_TIME * fast - 0.05), rtol=1e-3)


def test_bounds_of_torque_always_contain_no_force():
    state = random_state(0)
    body, reference = measure(ROBOT, state), make_reference(state, np.random.default_rng(0))
    reference = reference._replace(velocity=jnp.array([9.0, 0.0, 0.0, 0.0]))  # damping alone then takes all torque
    support = jnp.broadcast_to(feet_world(state), (NODES, 4, 3))
    rows = torque_rows(ROBOT, state, body, reference, nominal_motion(ROBOT, body, jnp.zeros((NODES, 4)), support))
    assert (rows.lower <= 0).all()
    assert (rows.upper >= 0).all()
    assert (rows.lower[0] == 0).any()


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_joint_rows_are_inverse_kinematics_to_first_order(seed: int):
    state, rng = random_state(seed), np.random.default_rng(seed)
    body = measure(ROBOT, state)
    reference = make_reference(state, rng)
    moved, support = reference.poses - reference.pose, jnp.broadcast_to(feet_world(state), (NODES, 4, 3))
    end = nominal_motion(ROBOT, body, moved, support)
    rows = joint_rows(ROBOT, end, jnp.ones((NODES, 4)), MARGIN)
    offset = ROBOT.joint_upper - MARGIN - rows.upper
    direction = jnp.asarray(rng.normal(size=6) * [0.3, 0.3, 0.3, 0.1, 0.1, 0.1], jnp.float32)

    def error(size: float) -> np.ndarray:
        node = 1
        change = size * direction
        predicted = rows.map[node] @ (end.position[node] + change) + offset[node]
        skew = jnp.array([[0, -change[2], change[1]], [change[2], 0, -change[0]], [-change[1], change[0], 0]])
        turn = jax.scipy.linalg.expm(body.R_world_yaw @ skew @ body.R_world_yaw.T)
        R = turn @ rotation_z(moved[node, 3]) @ body.R_world_base
        com = body.com_world + moved[node, :3] + body.R_world_yaw @ change[3:]
        exact = leg_inverse_kinematics(ROBOT, (support[node] - com) @ R + body.com_base)
        return np.array(predicted - exact)

    np.testing.assert_allclose(error(0.0), 0.0, atol=2e-5)
    large, small = np.linalg.norm(error(0.2)), np.linalg.norm(error(0.1))
    assert small < 0.01
    assert large / small == pytest.approx(4.0, rel=0.35)  # what is left is of second order
    np.testing.assert_allclose(
        rows.upper - rows.lower,
        np.broadcast_to(ROBOT.joint_upper - ROBOT.joint_lower - 2 * MARGIN, (NODES, 12)),
        rtol=1e-4,
    )


def test_a_foot_in_the_air_has_no_rows():
    state = random_state(0)
    body = measure(ROBOT, state)
    end = nominal_motion(ROBOT, body, jnp.zeros((1, 4)), feet_world(state)[None])
    rows = joint_rows(ROBOT, end, jnp.array([[1.0, 0.0, 1.0, 1.0]]), MARGIN)
    np.testing.assert_array_equal(rows.map[0, 3:6], 0.0)
    np.testing.assert_array_equal(rows.lower[0, 3:6], -np.inf)
    np.testing.assert_array_equal(rows.upper[0, 3:6], np.inf)
    assert np.isfinite(rows.upper[0, :3]).all()
