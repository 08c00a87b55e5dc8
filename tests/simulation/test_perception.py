"""A robot that walks by what it senses, in C MuJoCo, and one that stands by it in MJX."""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import ControlSettings, Diagnostics, Estimator, Reference, make_controller, no_diagnostics
from agile_jax.geometry import quaternion_to_rpy, wrap_angle
from agile_jax.robot import (
    RobotSettings,
    RobotState,
    SensorSettings,
    build_mujoco_model,
    collision_shapes,
    load_robot,
    standing_qpos,
)
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import (
    OUTCOME_NAMES,
    ClosedLoop,
    Estimated,
    MjxSlots,
    MujocoPhysics,
    MujocoSlots,
    Rollout,
    Sensed,
    batch_loop,
    gather,
    mjx_init,
    mjx_loop,
    policy_guidance,
    stream,
)

CONTROL = ControlSettings()
ROBOT = load_robot(RobotSettings())
SENSORS = SensorSettings()
SCENE = make_scene(SceneSettings.model_validate({"target": [1.0, 0.0, 0.28, 0.0]}))
MODEL = build_mujoco_model(SCENE, RobotSettings(), CONTROL.control_dt)
STARTS = np.array([[-0.3, 0.0, 0.27, 0.0], [-0.2, 0.3, 0.22, 0.4]])
KEYS = np.array([[1, 2], [3, 4]], np.uint32)


def straight(parameters: object, pose: jax.Array, velocity: jax.Array, dt: float) -> jax.Array:
    """To (1, 0) at up to 0.8 m/s."""
    error = jnp.array([1.0, 0.0, 0.28, 0.0]) - pose - velocity * dt
    return jnp.clip(2.0 * error.at[3].set(wrap_angle(error[3], jnp)), -0.8, 0.8)


@lru_cache
def estimated() -> Estimated:
    return Estimated(SENSORS, Estimator(ROBOT, SENSORS, CONTROL.control_dt))


@lru_cache
def walking():
    guidance, controller = policy_guidance(straight), make_controller(ROBOT, CONTROL)
    shapes, limit = collision_shapes(MODEL), np.array([1.5, 1.5, 1.0, 3.0])
    return batch_loop(ClosedLoop(SCENE, ROBOT, shapes, CONTROL, guidance, limit, controller, estimated()))


class Seen(NamedTuple):
    """What the robots believed, against the truth, a row for each plan of an episode that ran."""

    velocity_error: np.ndarray  # (rows, 3) [m/s]
    height_error: np.ndarray  # (rows,) [m]
    tilt_error: np.ndarray  # (rows, 2) [rad]


def walk(order: list[int], keys: np.ndarray = KEYS, limit: float = 4.0, slots: int = 4) -> tuple[Rollout, Seen]:
    qpos = np.stack([standing_qpos(ROBOT, STARTS[i]) for i in order]).astype(float)
    rows = []
    with MujocoPhysics(MODEL, slots, 1) as physics:
        running = MujocoSlots(walking(), physics, ())

        def watch(holds: np.ndarray) -> None:
            _, belief = running._episodes.perception
            alive, sensed = running._was_active, running._sensed
            # The belief is of the sample before the last step, and that sample is of the step before it.
            age = 2 * CONTROL.control_dt
            tilt = quaternion_to_rpy(np.asarray(belief.quat)) - quaternion_to_rpy(sensed.qpos[:, 3:7])
            values = (
                np.asarray(belief.velocity) - sensed.qvel[:, :3],
                np.asarray(belief.position)[:, 2] + age * sensed.qvel[:, 2] - sensed.qpos[:, 2],
                tilt[:, :2],
            )
            rows.append(Seen(*(value[alive] for value in values)))

        rollout = gather(len(order), stream(running, qpos, np.full(len(order), limit), watch, None, keys[order]))
    return rollout, Seen(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))


def test_a_robot_walks_by_its_estimate():
    rollout, seen = walk([0, 1])
    assert [OUTCOME_NAMES[code] for code in rollout.outcome.status] == ["success", "success"]
    assert (rollout.outcome.planar_error < 0.08).all()
    assert np.sqrt((seen.velocity_error**2).sum(-1).mean()) < 0.05
    assert np.sqrt((seen.height_error**2).mean()) < 5e-3
    assert np.sqrt((seen.tilt_error**2).mean()) < 0.02


def test_noise_belongs_to_the_episode_and_not_to_its_slot():
    (first, _), (second, _) = walk([0, 1, 0], limit=0.3), walk([1, 0], limit=0.3)
    other, _ = walk([0, 1], keys=KEYS + np.uint32(7), limit=0.3)
    for name, values in first.outcome._asdict().items():
        again = getattr(second.outcome, name)
        np.testing.assert_array_equal(values, [again[1], again[0], again[1]], err_msg=name)
    assert (other.outcome.work != first.outcome.work[:2]).all()


class Holding:
    """Joint PD to the posture that the episode began with, and the state that it was told last."""

    def init(self, robot_state: RobotState) -> tuple[jax.Array, RobotState]:
        return jnp.asarray(robot_state.joint_pos), robot_state

    def plan(self, state: tuple[jax.Array, RobotState], robot_state: RobotState, reference: Reference):
        return state

    def act(self, state: tuple[jax.Array, RobotState], robot_state: RobotState):
        torque = 100.0 * (state[0] - robot_state.joint_pos) - 1.0 * robot_state.joint_vel
        return (state[0], robot_state), jnp.clip(torque, -ROBOT.torque_limit, ROBOT.torque_limit)

    def diagnostics(self, state: tuple[jax.Array, RobotState]) -> Diagnostics:
        return no_diagnostics()


def test_the_estimate_runs_in_mjx():
    guidance = policy_guidance(lambda parameters, pose, velocity, dt: jnp.zeros(4))
    limit, shapes = np.full(4, 1.5), collision_shapes(MODEL)
    loop = ClosedLoop(SCENE, ROBOT, shapes, CONTROL, guidance, limit, Holding(), estimated())
    slots = MjxSlots(mjx_loop(loop, mjx_init(MODEL)), 2, ())
    qpos = np.stack([standing_qpos(ROBOT, np.array([1.0, 0.0, 0.27, 0.0]))] * 2).astype(float)
    rollout = gather(2, stream(slots, qpos, np.full(2, 2.0), None, None, KEYS))
    assert [OUTCOME_NAMES[code] for code in rollout.outcome.status] == ["success", "success"]
    episode = slots._states.episode
    _, told = episode.controller
    truth = slots._states.sensed.robot_state
    np.testing.assert_allclose(told.base_pos, truth.base_pos, atol=5e-3)
    np.testing.assert_allclose(told.base_lin_vel_world, truth.base_lin_vel_world, atol=0.05)
    assert not np.array_equal(told.base_pos[0], told.base_pos[1])  # each has its own noise


@pytest.mark.parametrize("delay", [0, 3])
def test_samples_come_late_and_sensors_err_as_they_are_told_to(delay: int):
    settings = SENSORS.model_copy(update={"delay": delay * CONTROL.control_dt, "joint_velocity_noise": 0.5})
    perception = Estimated(settings, Estimator(ROBOT, settings, CONTROL.control_dt))
    qpos = jnp.asarray(standing_qpos(ROBOT, np.array([0.0, 0.0, 0.27, 0.0])), jnp.float32)
    steps = 400

    def run(key: jax.Array):
        def look(state, k):
            # The joints turn by 1 rad/s, and the trunk speeds up by 2 m/s^2 along x.
            speed = jnp.float32(2.0 * CONTROL.control_dt) * k
            qvel = jnp.zeros(18).at[6:].set(1.0).at[0].set(speed)
            turned = qpos.at[7:].add(1.0 * CONTROL.control_dt * k)
            sensed = Sensed(turned, qvel, jnp.bool_(False), jnp.bool_(False), jnp.ones(4, bool))
            state, _ = perception.look(state, sensed)
            return state, jax.tree.map(lambda value: value[-1], state[0].waiting)

        start = Sensed(qpos, jnp.zeros(18), jnp.bool_(False), jnp.bool_(False), jnp.ones(4, bool))
        state, samples = jax.lax.scan(look, perception.init(start, key), jnp.arange(1, steps + 1))
        return samples, state[0]

    samples, sensors = jax.jit(jax.vmap(run))(jnp.asarray(np.arange(32, dtype=np.uint32).reshape(16, 2)))
    late = (1 + np.arange(steps) - delay).clip(0) * CONTROL.control_dt
    encoder = samples.joint_pos - qpos[7:] - late[None, :, None] - sensors.encoder_bias[:, None]
    assert np.std(encoder) == pytest.approx(SENSORS.encoder_noise, rel=0.05)
    assert np.abs(np.mean(encoder)) < 1e-4
    assert np.std(samples.joint_vel[:, delay:]) == pytest.approx(0.5, rel=0.05)
    force = np.asarray(samples.specific_force - sensors.accelerometer_bias[:, None])[:, delay:]
    np.testing.assert_allclose(force.mean((0, 1)), [2.0, 0.0, 9.81], atol=0.01)
    assert np.std(np.asarray(sensors.gyro_bias)) == pytest.approx(SENSORS.gyro_bias, rel=0.4)
