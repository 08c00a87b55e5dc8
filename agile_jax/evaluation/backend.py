"""Policy, controller and physics composed into something that runs a batch of episodes."""

import pathlib
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.control import ControllerState, ControlSettings, make_controller
from agile_jax.evaluation.planners import ExpertPlanner
from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.expert import ExpertSettings
from agile_jax.geometry import wrap_angle
from agile_jax.policy import PolicySettings, make_policy
from agile_jax.policy.braking import braking_law
from agile_jax.robot import RobotSettings, build_mujoco_model, collision_shapes, load_robot, standing_qpos
from agile_jax.scene import POSE_SIZE, Scene, SceneSettings, make_scene, planar_scene
from agile_jax.settings import BadInput
from agile_jax.simulation import (
    ClosedLoop,
    Guidance,
    Implementation,
    MjxSlots,
    MujocoPhysics,
    MujocoSlots,
    batch_loop,
    check_warp,
    mjx_init,
    mjx_loop,
    path_guidance,
    policy_guidance,
)
from agile_jax.training import load_policy


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

    slots: MujocoSlots[ControllerState] | MjxSlots[ControllerState]
    qpos: Callable[[np.ndarray], np.ndarray]  # starts (n, 4) -> initial configurations (n, nq)
    device: str
    plan_dt: float  # between two samples of a trace [s]
    query_seconds: Callable[
        [], float
    ]  # median time of one query of the planner, as the loop asks: all slots at once [s]


def command_parameters(inputs: Inputs, training_directory: pathlib.Path) -> Any:
    """The parameters of what the controller follows: those of the policy, from its checkpoints, or none."""
    if inputs.evaluation.planner != "policy":
        return ()
    scene, limits = make_scene(inputs.scene), inputs.expert.limits
    return load_policy(training_directory, scene, limits, inputs.policy).parameters


def make_backend(inputs: Inputs, parameters: Any, slots: int, threads: int) -> Backend:
    """Build the closed loop on the physics that `inputs.evaluation.backend` names.

    Args:
        inputs: settings.
        parameters: from `command_parameters`.
        slots: episodes at once.
        threads: of the C physics.
    """
    scene = make_scene(inputs.scene)
    acceleration_limit = np.array(inputs.expert.acceleration)
    guidance = _guidance(inputs, scene)
    robot = load_robot(inputs.robot)
    model = build_mujoco_model(scene, inputs.robot, inputs.control.control_dt)
    shapes = collision_shapes(model)
    controller = make_controller(robot, inputs.control)
    loop = ClosedLoop(scene, robot, shapes, inputs.control, guidance, acceleration_limit, controller)

    def qpos(starts: np.ndarray) -> np.ndarray:
        return np.asarray(jax.vmap(lambda start: standing_qpos(robot, start))(np.asarray(starts, np.float32)))

    planner = _planner(inputs, scene, slots)

    def query_seconds() -> float:
        if planner is not None:
            return float(np.median(planner.solve_times))
        still, now = jnp.zeros(POSE_SIZE), jnp.float32(0.0)
        query = jax.jit(jax.vmap(lambda pose: guidance(parameters, None, pose, still, now, inputs.control.plan_dt)))
        return _median_latency(query, np.tile(np.float32(scene.target), (slots, 1))) / slots

    plan_dt = inputs.control.plan_dt
    if inputs.evaluation.backend != "mujoco":
        devices = check_devices(inputs.evaluation)
        implementation: Implementation = "warp" if inputs.evaluation.backend == "mjx-warp" else "jax"
        on_device = MjxSlots(
            mjx_loop(loop, mjx_init(model, implementation, -(-slots // devices)), devices), slots, parameters
        )
        return Backend(on_device, qpos, str(jax.devices()[0].device_kind), plan_dt, query_seconds)
    in_threads = MujocoSlots(batch_loop(loop), MujocoPhysics(model, slots, threads), parameters, planner)
    return Backend(in_threads, qpos, "cpu", plan_dt, query_seconds)


def check_devices(settings: EvaluationSettings) -> int:
    """The number of devices that an evaluation in MJX uses.

    Raises:
        BadInput: there are fewer, or MuJoCo Warp cannot run here.
    """
    if settings.backend == "mjx-warp":
        check_warp()
    if settings.devices > len(jax.devices()):
        found = f"{len(jax.devices())} ({jax.devices()[0].platform})"
        raise BadInput(f"evaluation.devices = {settings.devices}, but JAX finds {found}")
    return settings.devices


def _guidance(inputs: Inputs, scene: Scene) -> Guidance:
    """What the reference follows."""
    if inputs.evaluation.planner == "policy":
        return policy_guidance(make_policy(scene, inputs.expert.limits, inputs.policy).command)
    if inputs.evaluation.planner != "straight":
        return path_guidance
    limits, rate = inputs.expert.limits, inputs.policy.approach_rate

    def straight(_: Any, pose: jax.Array, velocity: jax.Array, dt: float) -> jax.Array:
        error = pose + velocity * dt - jnp.asarray(scene.target, jnp.float32)
        error = error.at[3].set(wrap_angle(error[3], jnp))
        return braking_law(error, limits, rate).velocity

    return policy_guidance(straight)


def _planner(inputs: Inputs, scene: Scene, slots: int) -> ExpertPlanner | None:
    kind, settings = inputs.evaluation.planner, inputs.expert
    if kind in ("policy", "straight"):
        return None
    if kind == "open_loop_2d":
        settings, scene = settings.model_copy(update={"dimensions": "2d"}), planar_scene(scene)
    return ExpertPlanner(scene, settings, slots, inputs.evaluation.replan_interval if kind == "replan" else None)


def _median_latency(query: Callable[[np.ndarray], Any], poses: np.ndarray) -> float:
    """Of a call [s]."""
    query(poses).block_until_ready()
    seconds = []
    for _ in range(200):
        begun = time.perf_counter()
        query(poses).block_until_ready()
        seconds.append(time.perf_counter() - begun)
    return float(np.median(seconds))
