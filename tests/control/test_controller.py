"""The controller against MuJoCo: its feed-forward terms, its constraints, and walking."""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agile_jax.control import ControlSettings, Reference, make_controller
from agile_jax.control.mpc.solver.cascade import SOLVED
from agile_jax.control.torques import gravity_torque, leg_inertia, passive_torque
from agile_jax.geometry import quaternion_to_matrix, quaternion_to_rpy
from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot, robot_state, standing_qpos
from agile_jax.scene import SceneSettings, make_scene

SETTINGS = ControlSettings()
ROBOT = load_robot(RobotSettings())


@lru_cache
def model() -> mujoco.MjModel:
    return build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), SETTINGS.control_dt)


def random_state(seed: int) -> mujoco.MjData:
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model())
    quat = rng.normal(size=4) * [1, 0.1, 0.1, 1]
    data.qpos[:] = np.concatenate(
        [[0, 0, 5.0], quat / np.linalg.norm(quat), ROBOT.home_joint_pos + 0.3 * rng.normal(size=12)]
    )
    data.qvel[:] = rng.normal(size=18)
    return data


@pytest.mark.parametrize("seed", range(3))
def test_gravity_torque_equals_mujocos_bias_at_rest(seed: int):
    data = random_state(seed)
    data.qvel[:] = 0
    mujoco.mj_forward(model(), data)
    R = quaternion_to_matrix(data.qpos[3:7])
    torque = gravity_torque(ROBOT, jnp.asarray(data.qpos[7:19]), jnp.asarray(R))
    np.testing.assert_allclose(torque, data.qfrc_bias[6:], atol=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_passive_torque_cancels_the_joints_damping(seed: int):
    data = random_state(seed)
    mujoco.mj_forward(model(), data)
    torque = np.array(passive_torque(ROBOT, jnp.asarray(data.qvel[6:])))
    friction = ROBOT.joint_friction * np.tanh(data.qvel[6:] / 0.3)
    np.testing.assert_allclose(torque - friction, -data.qfrc_passive[6:], atol=1e-4)


def test_leg_inertia_is_mujocos():
    """The blocks of the mass matrix: with the trunk held, legs do not couple."""
    data = random_state(0)
    mujoco.mj_forward(model(), data)
    mass = np.zeros((18, 18))
    for column, unit in enumerate(np.eye(18)):
        mujoco.mj_mulM(model(), data, mass[column], unit)
    inertia = leg_inertia(ROBOT, data.qpos[7:19].astype(np.float32))
    for leg in range(4):
        block = slice(6 + 3 * leg, 9 + 3 * leg)
        np.testing.assert_allclose(inertia[leg], mass[block, block], atol=1e-5)


@lru_cache
def compiled() -> tuple[Any, Any, Any]:
    controller = make_controller(ROBOT, SETTINGS)

    def plan(state, qpos, qvel, reference):
        return controller.plan(state, robot_state(qpos, qvel), reference)

    def act(state, qpos, qvel):
        return controller.act(state, robot_state(qpos, qvel))

    return controller.init, jax.jit(plan), jax.jit(act)


def walk(velocity: float, height: float, duration: float) -> dict[str, np.ndarray]:
    """Walk ahead from standing while the height ramps from 0.28 m to `height`, in C MuJoCo."""
    init, plan, act = compiled()
    data = mujoco.MjData(model())
    data.qpos[:] = standing_qpos(ROBOT, np.array([0.0, 0.0, 0.28, 0.0]))
    mujoco.mj_forward(model(), data)

    def measured() -> tuple[jax.Array, jax.Array]:
        return jnp.asarray(data.qpos, jnp.float32), jnp.asarray(data.qvel, jnp.float32)

    state = init(robot_state(*measured()))
    log: dict[str, list[Any]] = {"z": [], "vx": [], "rpy": [], "force": [], "torque": [], "status": []}
    lead = np.arange(SETTINGS.mpc.horizon + 1) * SETTINGS.mpc.mpc_dt
    for tick in range(round(duration / SETTINGS.plan_dt)):
        t = tick * SETTINGS.plan_dt + lead
        speed = np.minimum(1.5 * t, velocity)
        z = np.maximum(0.28 - 0.3 * t, height) if height < 0.28 else np.full_like(t, 0.28)
        ahead = np.concatenate([[0.0], np.cumsum(speed[1:] * SETTINGS.mpc.mpc_dt)])
        poses = np.stack([data.qpos[0] + ahead, 0 * t, z, 0 * t], -1).astype(np.float32)
        velocities = np.stack([speed, 0 * t, 0 * t, 0 * t], -1).astype(np.float32)
        state = plan(state, *measured(), Reference(poses[0], velocities[0], poses[1:], velocities[1:]))
        log["force"].append(np.array(state.forces_world))
        log["status"].append(int(state.diagnostics.status))
        for _ in range(round(SETTINGS.plan_dt / SETTINGS.control_dt)):
            state, torque = act(state, *measured())
            data.ctrl[:] = torque
            mujoco.mj_step(model(), data)
            log["torque"].append(np.array(torque))
        log["z"].append(data.qpos[2])
        log["vx"].append(data.qvel[0])
        log["rpy"].append(quaternion_to_rpy(data.qpos[3:7]))
    return {name: np.array(values) for name, values in log.items()}


@pytest.mark.parametrize(("velocity", "height"), [(0.0, 0.28), (0.8, 0.28), (0.8, 0.165)])
def test_walks_at_the_wanted_speed_and_height(velocity: float, height: float):
    log = walk(velocity, height, 3.0)
    settled = slice(75, None)  # after 1.5 s
    assert abs(log["vx"][settled].mean() - velocity) < 0.1
    assert np.abs(log["z"][settled] - height).max() < 0.01
    assert np.degrees(np.abs(log["rpy"][settled, :2])).max() < 3.0
    assert (log["status"] == SOLVED).all()


def test_commands_stay_inside_cones_and_torque_limits():
    log = walk(0.8, 0.165, 1.5)
    force = log["force"]
    assert (np.hypot(force[..., 0], force[..., 1]) <= SETTINGS.mpc.friction * force[..., 2] + 1e-3).all()
    assert force[..., 2].max() <= SETTINGS.mpc.force_max
    assert np.abs(log["torque"]).max() <= 33.5 + 1e-4


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"plan_dt": 0.003}, "plan_dt"),
        ({"control_dt": 0.0}, "control_dt"),
        ({"raibert_gain": -0.1}, "raibert_gain"),
        ({"swing_stiffness": -60.0}, "swing_stiffness"),
        ({"swing_damping": 0.0}, "swing_damping"),
        ({"integral_gain": [4.0, -2.0, 4.0]}, "integral_gain"),
        ({"integral_limit": [0.0, 0.1, 0.1]}, "integral_limit"),
        ({"lead_limit": [0.05, 0.03]}, "lead_limit"),
        ({"gait": {"shortest_period": 0.0}}, "shortest_period"),
        ({"gait": {"duty": 0.0}}, "duty"),
        ({"gait": {"duty": 1.0}}, "duty"),
        ({"gait": {"walk_duty": 0.75}}, "walk_duty"),
        ({"gait": {"period": 0.0}}, "period"),
        ({"gait": {"step_height": -0.01}}, "step_height"),
        ({"gait": {"full_speed": 0.0}}, "full_speed"),
        ({"gait": {"stand_speed": -1.0}}, "stand_speed"),
        ({"gait": {"headroom_fraction": 1.5}}, "headroom_fraction"),
        ({"gait": {"stride": 0.1}}, "stride"),
        ({"mpc": {"horizon": 0}}, "horizon"),
        ({"mpc": {"mpc_dt": -0.03}}, "mpc_dt"),
        ({"mpc": {"weight_position": [20.0, -1.0, 100.0]}}, "weight_position"),
        ({"mpc": {"weight_force": 0.0}}, "weight_force"),
        ({"mpc": {"friction": float("nan")}}, "friction"),
        ({"mpc": {"iterations": 0}}, "iterations"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], key: str):
    with pytest.raises(ValueError, match=key):
        ControlSettings.model_validate(settings)
