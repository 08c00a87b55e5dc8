"""The simulated robot where it differs from the one that the controller knows."""

import numpy as np
import pytest

from agile_jax.experiment import Experiment
from agile_jax.robot import PlantSettings, RobotSettings, available_torque, build_mujoco_model, draw_plants, plant_model
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics
from agile_jax.simulation.physics.actuators import Actuators

MODEL = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), 0.002)
VARIED = PlantSettings(
    joint_damping=(0.5, 2.0), armature=0.25, com_shift=((-0.02, 0.02), 0.01, 0.0), delay=(0.0, 0.01), foot_friction=0.4
)


def test_draws_keep_their_ranges_and_depend_on_the_episode_alone() -> None:
    plants = draw_plants(VARIED, (1, 2), np.arange(200))
    assert 0.5 <= plants.joint_damping.min() < 0.6 < 1.9 < plants.joint_damping.max() <= 2.0
    assert np.abs(plants.com_shift[:, 0]).max() <= 0.02
    np.testing.assert_array_equal(plants.com_shift[:, 1], 0.01)
    np.testing.assert_array_equal(plants.armature, 0.25)
    assert np.isinf(plants.no_load_speed).all()
    some = draw_plants(VARIED, (1, 2), np.array([7, 150]))
    np.testing.assert_array_equal(some.delay, plants.delay[[7, 150]])
    other = draw_plants(VARIED.model_copy(update={"armature": 1.0}), (1, 2), np.array([7, 150]))
    np.testing.assert_array_equal(some.delay, other.delay)
    assert not np.array_equal(some.delay, draw_plants(VARIED, (1, 3), np.array([7, 150])).delay)


def test_a_model_has_the_joints_of_its_plant() -> None:
    changed = plant_model(MODEL, draw_plants(VARIED, (0,), np.zeros(1, int)).of(0))
    np.testing.assert_allclose(changed.dof_armature[6:], 0.0025)
    assert 1.0 <= changed.dof_damping[7] <= 4.0
    np.testing.assert_array_equal(changed.dof_frictionloss, MODEL.dof_frictionloss)
    assert changed.geom("FR_foot").friction[0] == 0.4


def test_motors_fade_with_speed_and_brake_with_all_their_torque() -> None:
    limit, speed = np.full(12, 30.0), np.array([20.0])
    torque, joint_vel = np.full((1, 12), 25.0), np.zeros((1, 12))
    joint_vel[0, :6] = 5.0, 10.0, 15.0, 20.0, 30.0, -15.0
    given = available_torque(torque, joint_vel, limit, speed)
    np.testing.assert_allclose(given[0, :6], [25.0, 25.0, 15.0, 0.0, 0.0, 25.0])
    np.testing.assert_array_equal(available_torque(torque, joint_vel, limit, np.array([np.inf])), torque)


def test_torques_come_late_by_their_delay_and_each_robot_has_its_own() -> None:
    motors = Actuators(2, np.full(12, 30.0), 0.002)
    plants = draw_plants(PlantSettings(delay=(0.0, 0.01)), (0,), np.arange(2))
    motors.reset(np.arange(2), plants._replace(delay=np.array([0.004, 0.0])))
    everyone, still = np.ones(2, bool), np.zeros((2, 12))
    given = [motors(np.full((2, 12), k + 1.0), still, everyone)[:, 0] for k in range(5)]
    np.testing.assert_array_equal(given, [[0, 1], [0, 2], [1, 3], [2, 4], [3, 5]])
    motors.reset(np.array([0]), None)
    np.testing.assert_array_equal(motors(np.full((2, 12), 9.0), still, everyone)[:, 0], [9, 9])


def test_episodes_with_other_joints_stop_sooner() -> None:
    """In free fall without torque a joint's speed decays with its damping over its inertia."""
    plants = draw_plants(PlantSettings(joint_damping=(0.5, 2.0)), (0,), np.arange(3))
    plants = plants._replace(joint_damping=np.array([0.0, 1.0, 2.0]), joint_friction=np.zeros(3))
    qpos = np.tile(MODEL.key("home").qpos, (3, 1))
    qpos[:, 2] = 100.0
    with MujocoPhysics(MODEL, 3, 1) as physics:
        physics.reset(qpos, None, plants)
        for k in range(10):
            sensed = physics.step(np.full((3, 12), 0.5 if k < 5 else 0.0))
        speed = np.abs(sensed.qvel[:, 8])
        assert speed[0] > 1.5 * speed[1] > 1.5 * speed[2] > 0
        sensed = physics.reset(qpos[:1], np.array([2]))
        for _ in range(3):
            sensed = physics.step(np.full((3, 12), 0.5))
        assert physics._models[2] is MODEL


@pytest.mark.parametrize(
    "plant", [{"delay": 0.01}, {"no_load_speed": 21.0}, {"push_impulse": 2.0}, {"mass": (0.9, 1.1)}]
)
def test_mjx_refuses_what_it_cannot_simulate(plant: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="mujoco"):
        Experiment.model_validate({"name": "n", "plant": plant, "evaluation": {"backend": "mjx"}})
    Experiment.model_validate({"name": "n", "plant": plant})


def test_a_range_begins_with_its_lower_end() -> None:
    with pytest.raises(ValueError, match="the lower end of a range comes first"):
        PlantSettings(joint_damping=(2.0, 0.5))
