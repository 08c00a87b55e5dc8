"""Policy, controller and physics composed into something that runs a batch of episodes."""

import pathlib
from collections.abc import Callable
from typing import NamedTuple, Protocol

import jax
import numpy as np

from agile_jax.control import ControlSettings
from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.expert import ExpertSettings
from agile_jax.policy import PolicySettings, load_parameters, make_policy
from agile_jax.progress import silent
from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot, standing_qpos
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics, Rollout, batch_loop, make_closed_loop, mjx_init, mjx_runner, run_mujoco


class Inputs(Protocol):
    """The settings that an evaluation reads; an Experiment has them."""

    @property
    def seed(self) -> int: ...  # noqa: D102
    @property
    def scene(self) -> SceneSettings: ...  # noqa: D102
    @property
    def expert(self) -> ExpertSettings: ...  # noqa: D102
    @property
    def policy(self) -> PolicySettings: ...  # noqa: D102
    @property
    def robot(self) -> RobotSettings: ...  # noqa: D102
    @property
    def control(self) -> ControlSettings: ...  # noqa: D102
    @property
    def evaluation(self) -> EvaluationSettings: ...  # noqa: D102


class Backend(NamedTuple):
    """What simulates a batch."""

    run: Callable[[np.ndarray, np.ndarray, int], Rollout]  # (starts (n, 4), time limits (n,) [s], traced)
    device: str


def make_backend(
    inputs: Inputs,
    training_directory: pathlib.Path,
    batch: int,
    threads: int,
    progress: Callable[[int, int, str], None] = silent,
) -> Backend:
    """Load the policy and build the closed loop on the physics that `inputs.evaluation.backend` names.

    Args:
        inputs: settings.
        training_directory: holds the policy's checkpoints.
        batch: episodes at once.
        threads: of the C physics.
        progress: called with (episodes ended, episodes, note).
    """
    scene = make_scene(inputs.scene)
    acceleration_limit = np.array(inputs.expert.acceleration)
    policy = make_policy(scene, np.array(inputs.expert.velocity), acceleration_limit, inputs.policy)
    parameters = load_parameters(training_directory, policy)
    robot = load_robot(inputs.robot)
    loop = make_closed_loop(scene, robot, inputs.control, policy.command, acceleration_limit)
    model = build_mujoco_model(scene, inputs.robot, inputs.control.control_dt)

    def qpos(starts: np.ndarray) -> np.ndarray:
        return np.stack([np.asarray(standing_qpos(robot, start)) for start in starts])

    if inputs.evaluation.backend == "mjx":
        runner = mjx_runner(loop, mjx_init(model))

        def run_on_device(starts: np.ndarray, limits: np.ndarray, traced: int) -> Rollout:
            del traced  # one compiled loop records nothing
            return runner(parameters, qpos(starts), limits)

        return Backend(run_on_device, str(jax.devices()[0].device_kind))

    physics, compiled = MujocoPhysics(model, batch, threads), batch_loop(loop)

    def run_in_threads(starts: np.ndarray, limits: np.ndarray, traced: int) -> Rollout:
        return run_mujoco(compiled, physics, parameters, qpos(starts), limits, scene, traced, progress)

    return Backend(run_in_threads, "cpu")
