"""What the controller learns of the joints, from legs in the air whose joints differ from the file."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agile_jax.control.joint_model import joint_momentum, learn, nothing_learned, record
from agile_jax.robot import (
    PlantSettings,
    RobotModel,
    RobotSettings,
    build_mujoco_model,
    draw_plants,
    load_robot,
    robot_state,
)
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics

ROBOT = load_robot(RobotSettings())
MODEL = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), 0.002)
HOME = MODEL.key("home").qpos
IN_THE_AIR = jnp.ones(4, bool)


def test_momentum_is_that_of_mujocos_mass_matrix() -> None:
    rng = np.random.default_rng(0)
    data, matrix = mujoco.MjData(MODEL), np.zeros((18, 18))
    data.qpos[:] = HOME + np.r_[np.zeros(7), rng.uniform(-0.4, 0.4, 12)]
    data.qpos[3:7] = rng.normal(size=4)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qvel[:] = rng.normal(size=18) * np.r_[np.ones(6), np.full(12, 8.0)]
    mujoco.mj_forward(MODEL, data)
    for column, unit in zip(matrix, np.eye(18), strict=True):
        mujoco.mj_mulM(MODEL, data, column, unit)
    state = robot_state(np.float32(data.qpos), np.float32(data.qvel))
    momentum, slope = joint_momentum(ROBOT, state)
    np.testing.assert_allclose(momentum + 0.01 * data.qvel[6:], (matrix @ data.qvel)[6:], rtol=1e-4, atol=1e-4)
    # dp/dt = tau + dL/dq for what moves freely: MuJoCo's acceleration without passive torques and contacts.
    acceleration = np.linalg.solve(matrix, -data.qfrc_bias)
    after, step = mujoco.MjData(MODEL), 1e-5
    after.qpos[:], after.qvel[:] = data.qpos, data.qvel + step * acceleration
    mujoco.mj_integratePos(MODEL, after.qpos, data.qvel + step / 2 * acceleration, step)
    with jax.enable_x64(True):
        states = [robot_state(jnp.asarray(one.qpos), jnp.asarray(one.qvel)) for one in (data, after)]
        rate = (joint_momentum(ROBOT, states[1])[0] - joint_momentum(ROBOT, states[0])[0]) / step
    rotors = 0.01 * acceleration[6:]
    np.testing.assert_allclose(rate + rotors, slope, rtol=1e-3, atol=1e-2)


def swinging(
    factors: dict[str, float], seconds: float, noise: float = 0.0, robot: RobotModel = ROBOT
) -> list[np.ndarray]:
    """What is believed at last of damping and rotors, over the A1's, of a robot that falls and swings its legs.

    Args:
        factors: on its true joints.
        seconds: that it swings.
        noise: standard deviation of the measured joint velocities [rad/s].
        robot: as its controller is told.
    """
    plants = draw_plants(PlantSettings.model_validate(factors), (0,), np.zeros(1, int))
    first = robot_state(np.float32(HOME), np.zeros(18, np.float32))
    model = nothing_learned(robot, first)
    note = jax.jit(lambda model, state, torque: record(model, state, torque, IN_THE_AIR, 0.002))
    close = jax.jit(lambda model, state: learn(robot, model, state, IN_THE_AIR, 0.02))
    rng, phase = np.random.default_rng(1), np.array([0.0, 1.0, 2.0] * 4) + np.repeat([0.0, 3.0, 3.0, 0.0], 3)
    with MujocoPhysics(MODEL, 1, 1) as physics:
        sensed = physics.reset(HOME[None] + np.r_[0, 0, 500.0, np.zeros(16)], None, plants)
        for k in range(round(seconds / 0.002)):
            qvel = sensed.qvel[0] + noise * rng.normal(size=18) * np.r_[np.zeros(6), np.ones(12)]
            state = robot_state(np.float32(sensed.qpos[0]), np.float32(qvel))
            if k % 10 == 0:
                model = close(model, state)
            goal = HOME[7:] + np.array([0.1, 0.4, 0.4] * 4) * np.sin(2 * np.pi * 3.6 * 0.002 * k + phase)
            torque = np.clip(60 * (goal - sensed.qpos[0, 7:]) - sensed.qvel[0, 6:], -33.5, 33.5)
            model = note(model, state, np.float32(torque))
            sensed = physics.step(torque[None])
    told = model.told(robot)
    return [np.array(told.joint_damping / ROBOT.joint_damping), np.array(told.joint_armature / ROBOT.joint_armature)]


@pytest.mark.parametrize(("damping", "armature"), [(1.0, 1.0), (0.5, 1.0), (2.0, 1.0), (1.0, 0.25), (0.5, 2.0)])
def test_the_factors_of_damping_and_rotors_are_found_within_half_a_second(damping: float, armature: float) -> None:
    factors = {"joint_damping": damping, "joint_friction": damping, "armature": armature}
    found = swinging(factors, 0.5)
    np.testing.assert_allclose(found[0][[1, 2]], damping, rtol=0.04)
    np.testing.assert_allclose(found[1][[1, 2]], armature, rtol=0.1, atol=0.08)


def test_joints_that_the_file_calls_ideal_are_found_too() -> None:
    ideal = ROBOT._replace(**dict.fromkeys(("joint_damping", "joint_friction", "joint_armature"), np.zeros(12)))
    found = swinging({}, 1.0, robot=ideal)
    np.testing.assert_allclose(found[0][[1, 2]], 1.0, atol=0.1)
    np.testing.assert_allclose(found[1][[1, 2]], 1.0, atol=0.15)


def test_noise_of_the_measured_velocities_does_little() -> None:
    found = swinging({"joint_damping": 0.5, "joint_friction": 0.5}, 2.0, noise=0.87)
    np.testing.assert_allclose(found[0][[1, 2]], 0.5, atol=0.1)
