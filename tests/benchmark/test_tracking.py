"""Commands are followed, disturbances disturb, and what is measured is what happened."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agile_jax.benchmark.tracking import summary
from agile_jax.benchmark.workloads.commands import Command, random_commands
from agile_jax.benchmark.workloads.disturbance import (
    Disturbance,
    SensorNoise,
    disturbed_plants,
    draw,
    push_force,
    sense,
)
from agile_jax.benchmark.workloads.tracking import UNDISTURBED, TrackingLoop, track_commands, tracking_loop
from agile_jax.control import ControlSettings, make_mpc_controller
from agile_jax.geometry import quaternion_to_rpy
from agile_jax.robot import PlantSettings, RobotSettings, build_mujoco_model, draw_plants, load_robot, plant_model
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics, Sensed

CONTROL, ROBOT = ControlSettings(), RobotSettings()


@lru_cache
def loop() -> TrackingLoop:
    robot = load_robot(ROBOT)
    return tracking_loop(robot, CONTROL, UNDISTURBED, make_mpc_controller(robot, CONTROL))


@lru_cache
def model() -> mujoco.MjModel:
    return build_mujoco_model(make_scene(SceneSettings()), ROBOT, CONTROL.control_dt)


def track(commands: Command, duration: float, **others):
    return track_commands(loop(), commands, duration, ROBOT, start_height=0.28, threads=1, **others)


def test_commands_are_met_and_standing_does_not_drift():
    seen = []
    commands = Command(
        np.array([[0.0, 0.0], [1.0, -0.4], [0.5, 0.0], [0.0, 0.0]]),
        np.array([0.0, 0.8, 0.0, 0.0]),
        np.array([0.28, 0.28, 0.17, 0.22]),
    )
    columns = track(commands, 3.0, watch=lambda sensed, states: seen.append((sensed.qpos, states.controller.gait)))
    row = summary(columns)
    assert row["met"] == row["survived"] == 4
    assert row["cone_violation_max_n"] < 1e-3
    assert row["torque_share_max"] <= 1.0
    assert row["joint_violation_max_rad"] < 1e-3
    for still in (0, 3):  # at the start height, and after a crouch
        track_of = np.array([qpos[still, :2] for qpos, _ in seen])
        assert np.abs(track_of - track_of[75]).max() < 0.02
        assert bool(seen[-1][1].stand[still])
        assert np.array(seen[-1][1].landed[still]).all()
    yaw = np.unwrap([quaternion_to_rpy(qpos[1, 3:7])[2] for qpos, _ in seen])
    assert (yaw[-1] - yaw[74]) / 1.5 == pytest.approx(0.8, abs=0.05)


def test_joints_and_rotors_that_the_controller_is_not_told_of_change_little():
    """With all of the believed damping fed back, the first fell; without rotors, the MPC's own roll threw over all."""
    commands = Command(np.tile([0.8, 0.0], (5, 1)), np.zeros(5), np.full(5, 0.17))
    joints = np.array([0.75, 0.0, 1.0, 2.0, 0.0])
    plants = draw_plants(PlantSettings(), (0,), np.arange(5))
    plants = plants._replace(joint_damping=joints, joint_friction=joints, armature=np.array([1.0, 1.0, 0.0, 2.0, 0.0]))
    columns = track(commands, 3.0, plants=plants)
    assert summary(columns)["survived"] == 5
    assert columns["height_error_max"].max() < 0.015
    assert columns["velocity_rms"][[0, 1, 2, 4]].max() < 0.12


def test_a_robot_that_hardly_moves_steps_before_it_leans_off_its_feet():
    velocity = np.array([[0.045, 0.0], [0.0, 0.045], [0.0, 0.0]])
    columns = track(Command(velocity, np.array([0.0, 0.0, 0.15]), np.full(3, 0.17)), 7.0)
    row = summary(columns)
    assert row["met"] == 3
    assert row["joint_violations"] == row["torque_violations"] == row["cone_violations"] == row["mpc_failures"] == 0


def test_random_commands_do_not_depend_on_their_number():
    few, many = (random_commands(n, 3, (0.0, 1.2), 0.5, 1.0, 0.28) for n in (4, 9))
    np.testing.assert_array_equal(few.velocity, many.velocity[:4])
    assert (many.velocity[:, 0] >= 0).all()
    assert (np.abs(many.yaw_rate) <= 1).all()


def test_a_push_gives_its_impulse():
    """In free fall, the whole robot's momentum changes by exactly the impulse."""
    draws = draw(3, 0)
    disturbance = Disturbance(impulse=6.0)
    qpos = np.tile(model().key("home").qpos, (3, 1))
    qpos[:, 2] = 500.0  # it never arrives
    with MujocoPhysics(model(), 3, 1) as physics:
        sensed = physics.reset(qpos)
        for k in range(round(3.2 / 0.002)):
            sensed = physics.step(np.zeros((3, 12)), None, push_force(disturbance, draws, k * 0.002, sensed.qpos))
    data = mujoco.MjData(model())
    for episode in range(3):
        data.qpos[:], data.qvel[:] = sensed.qpos[episode], sensed.qvel[episode]
        mujoco.mj_forward(model(), data)
        mujoco.mj_subtreeVel(model(), data)
        sideways = 12.453 * data.subtree_linvel[1, :2]
        assert np.hypot(*sideways) == pytest.approx(6.0, rel=0.03)
        assert np.sign(sideways[1]) == draws.sign[episode]


def test_models_differ_as_they_should_and_the_original_stays():
    draws = draw(8, 1)
    before = model().body_mass.copy()
    disturbance = Disturbance(trunk_mass=0.2, com_offset=0.03, plant=PlantSettings(foot_friction=0.4))
    plants = disturbed_plants(disturbance, draws)
    assert plants is not None
    for i, sign in enumerate(draws.sign):
        changed = plant_model(model(), plants.of(i))
        assert changed.body_mass[1] == pytest.approx(4.713 * (1 + 0.2 * sign))
        assert np.linalg.norm(changed.body_ipos[1] - model().body_ipos[1]) == pytest.approx(0.03)
        assert changed.geom("FR_foot").friction[0] == 0.4
    np.testing.assert_array_equal(model().body_mass, before)
    assert disturbed_plants(UNDISTURBED, draws) is None


def test_sensed_noise_has_its_standard_deviation_and_leaves_a_rotation():
    truth = Sensed(jnp.asarray(model().key("home").qpos), jnp.zeros(18), False, False, jnp.ones(4, bool))
    noise = SensorNoise((0.01, 0.0, 0.02), 0.2, 0.1, 0.03, 1.5)
    keys = jax.random.split(jax.random.key(0), 4_000)
    drifts = jax.random.normal(jax.random.key(1), (4_000, 3))
    seen = jax.vmap(lambda key, drift: sense(truth, noise, drift, key))(keys, drifts)
    np.testing.assert_allclose(np.linalg.norm(seen.qpos[:, 3:7], axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(np.std(quaternion_to_rpy(np.array(seen.qpos[:, 3:7])), 0), [0.01, 0, 0.02], atol=1e-3)
    np.testing.assert_allclose(np.std(np.array(seen.qvel), 0)[[0, 3, 6]], [0.1, 0.2, 1.5], rtol=0.05)
    np.testing.assert_allclose(np.std(seen.qpos[:, 7:], 0), 0.03, rtol=0.1)
    np.testing.assert_array_equal(seen.qpos[:, :3], np.tile(truth.qpos[:3], (4_000, 1)))
