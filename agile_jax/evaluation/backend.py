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
from agile_jax.robot import RobotSettings, build_mujoco_model, collision_shapes, load_robot, standing_qpos
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import (
    MjxSlots,
    MujocoPhysics,
    MujocoSlots,
    batch_loop,
    make_closed_loop,
    mjx_init,
    mjx_loop,
)


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
    """What simulates episodes."""

    slots: MujocoSlots | MjxSlots
    qpos: Callable[[np.ndarray], np.ndarray]  # starts (n, 4) -> initial configurations (n, nq)
    device: str
    plan_dt: float  # between two samples of a trace [s]


def make_backend(inputs: Inputs, training_directory: pathlib.Path, slots: int, threads: int) -> Backend:
    """Load the policy and build the closed loop on the physics that `inputs.evaluation.backend` names.

    Args:
        inputs: settings.
        training_directory: holds the policy's checkpoints.
        slots: episodes at once.
        threads: of the C physics.
    """
    scene = make_scene(inputs.scene)
    acceleration_limit = np.array(inputs.expert.acceleration)
    policy = make_policy(scene, np.array(inputs.expert.velocity), acceleration_limit, inputs.policy)
    parameters = load_parameters(training_directory, policy)
    robot = load_robot(inputs.robot)
    model = build_mujoco_model(scene, inputs.robot, inputs.control.control_dt)
    shapes = collision_shapes(model)
    loop = make_closed_loop(scene, robot, shapes, inputs.control, policy.velocity, acceleration_limit)

    def qpos(starts: np.ndarray) -> np.ndarray:
        return np.asarray(jax.vmap(lambda start: standing_qpos(robot, start))(np.asarray(starts, np.float32)))

    if inputs.evaluation.backend == "mjx":
        on_device = MjxSlots(mjx_loop(loop, mjx_init(model)), slots, parameters)
        return Backend(on_device, qpos, str(jax.devices()[0].device_kind), inputs.control.plan_dt)
    in_threads = MujocoSlots(batch_loop(loop), MujocoPhysics(model, slots, threads), parameters)
    return Backend(in_threads, qpos, "cpu", inputs.control.plan_dt)
