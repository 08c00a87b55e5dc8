"""When the robot stands, and where its feet stand ahead."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import ControlSettings, Reference, gait, make_mpc_controller
from agile_jax.control.body import measure
from agile_jax.control.footholds import plan_footholds, plan_support
from agile_jax.control.rest import at_rest
from agile_jax.robot import RobotSettings, leg_forward_kinematics, load_robot, robot_state, standing_qpos

ROBOT = load_robot(RobotSettings())
SETTINGS = ControlSettings()
NOMINAL = make_mpc_controller(ROBOT, SETTINGS).nominal_feet
POSE = np.array([0.3, -0.2, 0.27, 0.4], np.float32)


def still(pose: np.ndarray = POSE, velocity: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> Reference:
    pose, velocity = jnp.asarray(pose, jnp.float32), jnp.asarray(velocity, jnp.float32)
    ahead = pose + velocity * SETTINGS.mpc.mpc_dt * jnp.arange(1, SETTINGS.mpc.horizon + 1)[:, None]
    return Reference(pose, velocity, ahead, jnp.tile(velocity, (SETTINGS.mpc.horizon, 1)))


@jax.jit
def _rests(reference: Reference, standing: jax.Array, speed: jax.Array, moved_feet: jax.Array) -> jax.Array:
    qpos = jnp.asarray(standing_qpos(ROBOT, POSE), jnp.float32)
    state = robot_state(qpos, jnp.zeros(18).at[0].set(speed))
    body = measure(ROBOT, state)
    feet = state.base_pos + leg_forward_kinematics(ROBOT, state.joint_pos) @ body.R_world_base.T
    feet = feet.at[:, :2].add(moved_feet)
    return at_rest(standing, body, state, feet, NOMINAL, reference, SETTINGS.gait.stand_speed)


def rests(
    reference: Reference, standing: bool = False, speed: float = 0.0, moved_feet: tuple[float, float] = (0.0, 0.0)
) -> bool:
    return bool(_rests(reference, jnp.bool_(standing), jnp.float32(speed), jnp.array(moved_feet)))


def test_a_robot_stands_where_nothing_asks_for_a_step():
    assert rests(still())
    assert not rests(still(velocity=(0.05, 0.0, 0.0, 0.0)))
    assert not rests(still(velocity=(0.0, 0.0, 0.0, 0.15)))
    assert not rests(still(POSE + np.float32([0.04, 0.0, 0.0, 0.0])))
    assert not rests(still(POSE + np.float32([0.0, 0.0, 0.0, 0.07])))
    assert not rests(still(), speed=0.2)
    assert not rests(still(), moved_feet=(0.03, 0.0))


def test_a_standing_robot_tolerates_twice_as_much():
    lead = still(POSE + np.float32([0.04, 0.0, 0.0, 0.0]))
    assert rests(lead, standing=True)
    assert not rests(still(POSE + np.float32([0.07, 0.0, 0.0, 0.0])), standing=True)


def swinging() -> gait.Gait:
    """A trot in which FL and RR are in the middle of their swing."""
    begun = gait.start(SETTINGS.gait)
    now = begun._replace(phase=jnp.float32(0.25), stand=jnp.bool_(False))
    return now._replace(landed=gait.scheduled(SETTINGS.gait, now))


def test_feet_stand_where_they_are_then_on_their_footholds_then_a_stride_further():
    clock = swinging()
    feet, footholds = jnp.zeros((4, 3)), jnp.ones((4, 3))
    elapsed = jnp.array([0.0, clock.period, 2 * clock.period])
    reference = still(velocity=(0.8, 0.1, 0.0, 0.0))
    support = np.array(plan_support(SETTINGS.gait, clock, elapsed, feet, footholds, reference))
    standing = np.array(clock.landed)
    assert standing.sum() == 2
    np.testing.assert_array_equal(support[0], np.where(standing[:, None], feet, footholds))
    stride = np.array([0.8, 0.1, 0.0]) * float(clock.period)
    np.testing.assert_allclose(support[1], np.ones((4, 3)), atol=1e-6)  # each has landed once
    np.testing.assert_allclose(support[2], np.ones((4, 3)) + stride, atol=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_footholds_of_a_robot_that_marches_in_place_are_under_its_hips(yaw: float):
    pose = np.array([0.0, 0.0, 0.27, yaw], np.float32)
    state = robot_state(jnp.asarray(standing_qpos(ROBOT, pose), jnp.float32), jnp.zeros(18))
    clock, reference, window = swinging(), still(pose), jnp.array([-0.2, 0.2])

    @jax.jit
    def footholds() -> jax.Array:
        return plan_footholds(ROBOT, SETTINGS, window, NOMINAL, clock, state, measure(ROBOT, state), reference)

    found = np.array(footholds())
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    np.testing.assert_allclose(found[:, :2], NOMINAL @ turn.T, atol=1e-5)
    np.testing.assert_allclose(found[:, 2], ROBOT.foot_radius, atol=1e-6)
