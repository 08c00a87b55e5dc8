"""One scene, one model and recorded motions for the tests of the physics."""

import mujoco
import numpy as np
import pytest

from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot, standing_qpos
from agile_jax.scene import SceneSettings, TableSettings, make_scene

TABLE = TableSettings(kind="table", position=(1.0, 0.0), size=(0.5, 1.0), underside=0.25)


@pytest.fixture(scope="session")
def robot():
    return load_robot(RobotSettings())


@pytest.fixture(scope="session")
def model() -> mujoco.MjModel:
    return build_mujoco_model(make_scene(SceneSettings(obstacles=(TABLE,))), RobotSettings(), 0.002)


@pytest.fixture(scope="session")
def starts(robot) -> np.ndarray:
    """Six starts (6, 19): standing in the open, under the table, and running into it; one of them falls on its side."""
    poses = [
        [0.0, 0.0, 0.27, 0.0],
        [0.0, 0.5, 0.30, 1.0],
        [1.0, 0.0, 0.17, 0.1],
        [0.47, 0.0, 0.27, 0.0],
        [1.0, 0.2, 0.21, 0.5],
        [0.0, -1.0, 0.30, 0.0],
    ]
    qpos = np.array([standing_qpos(robot, np.asarray(pose, float)) for pose in poses], float)
    qpos[5, 3:7] = [np.cos(0.6), np.sin(0.6), 0.0, 0.0]
    return qpos


@pytest.fixture(scope="session")
def torque_law(robot):
    """PD with a moving target, a function of the episode's own state and time: (qpos, qvel, k) -> torques (n, 12)."""

    def law(qpos: np.ndarray, qvel: np.ndarray, k: int) -> np.ndarray:
        target = robot.home_joint_pos + 0.4 * np.sin(0.06 * k + np.arange(12))
        return 60.0 * (target - qpos[:, 7:]) - 1.0 * qvel[:, 6:]

    return law
