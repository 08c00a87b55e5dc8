"""Policy, controller and physics composed into something that runs a batch of episodes."""

import pathlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree, UInt32
from threadpoolctl import threadpool_limits

from agile_jax.control import Estimator, make_controller
from agile_jax.evaluation.planners import ExpertPlanner
from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.experiment import Experiment
from agile_jax.geometry import wrap_angle
from agile_jax.policy import make_policy
from agile_jax.policy.braking import braking_law
from agile_jax.robot import (
    Plant,
    PlantSettings,
    RobotModel,
    build_mujoco_model,
    collision_shapes,
    draw_plants,
    load_robot,
    plant_model,
    standing_qpos,
)
from agile_jax.scene import POSE_SIZE, Scene, make_scene, planar_scene, streams
from agile_jax.settings import BadInput
from agile_jax.simulation import (
    IDEAL,
    BulletPhysics,
    ClosedLoop,
    Estimated,
    Guidance,
    HostPhysics,
    Implementation,
    MjxSlots,
    MujocoPhysics,
    MujocoSlots,
    Perception,
    batch_loop,
    check_bullet,
    check_warp,
    mjx_init,
    mjx_loop,
    path_guidance,
    policy_guidance,
    set_solver,
    slowed,
)
from agile_jax.single_precision import in_float32
from agile_jax.training import load_policy

QUERIES = 200  # of which the median time is taken
# Decorates what runs the controller. JAX factorises its small matrices with the BLAS of SciPy, whose last digits depend
# on the number of its threads, and more than one are slower there.
on_one_blas_thread = threadpool_limits.wrap(limits=1, user_api="blas")


@dataclass(frozen=True)
class Backend:
    """What simulates episodes: robot, controller and what guides it, on some physics.

    Attributes:
        slots: where the episodes run.
        robot: constants.
        device: that computes, for the summary.
        plan_dt: between two samples of a trace [s].
        guidance: what the controller follows.
        parameters: of the guidance.
        planner: the expert that plans while the episodes run, or None.
        target: pose [m, rad].
        draw: the robots of episodes by their numbers, where each has its own.
        stream: of random numbers, of the sensors.
    """

    slots: MujocoSlots | MjxSlots
    robot: RobotModel
    device: str
    plan_dt: float
    guidance: Guidance
    parameters: PyTree
    planner: ExpertPlanner | None
    target: Float[np.ndarray, "4"]
    draw: Callable[[Int[np.ndarray, " n"]], Plant] | None
    stream: tuple[int, ...]

    def plants(self, episodes: Int[np.ndarray, " n"], push_after: Float[np.ndarray, " n"]) -> Plant | None:
        """The robots of episodes by their numbers; None where all are as the model says.

        Args:
            episodes: numbers.
            push_after: from `simulation.push_after` [s].
        """
        return None if self.draw is None else self.draw(episodes)._replace(push_after=push_after)

    def keys(self, episodes: Int[np.ndarray, " n"]) -> UInt32[np.ndarray, "n 2"]:
        """Of what is random in episodes, by their numbers."""
        sequences = [np.random.SeedSequence((*self.stream, episode)) for episode in episodes.tolist()]
        return np.stack([sequence.generate_state(2) for sequence in sequences])

    def qpos(self, starts: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 19"]:
        """The coordinates of the robot that stands at poses [m, rad]."""
        stand = jax.vmap(in_float32(lambda start: standing_qpos(self.robot, start)))
        return np.asarray(stand(np.asarray(starts, np.float32)))

    def query_seconds(self) -> float:
        """The median time of one query of the guidance, as the loop asks: for all slots at once [s]."""
        if self.planner is not None:
            return float(np.median(self.planner.solve_times))
        still, now = jnp.zeros(POSE_SIZE), jnp.float32(0.0)
        ask = jax.jit(jax.vmap(lambda pose: self.guidance(self.parameters, None, pose, still, now, self.plan_dt)))
        poses = np.tile(np.float32(self.target), (self.slots.count, 1))
        ask(poses).block_until_ready()
        seconds = []
        for _ in range(QUERIES):
            begun = time.perf_counter()
            ask(poses).block_until_ready()
            seconds.append(time.perf_counter() - begun)
        return float(np.median(seconds)) / self.slots.count


def command_parameters(experiment: Experiment, training_directory: pathlib.Path) -> PyTree:
    """The parameters of what the controller follows: those of the policy, from its checkpoints, or none."""
    if experiment.evaluation.planner != "policy":
        return ()
    scene, limits = make_scene(experiment.scene), experiment.expert.limits
    return load_policy(training_directory, scene, limits, experiment.policy).parameters


def make_backend(experiment: Experiment, parameters: PyTree, slots: int, threads: int) -> Backend:
    """Build the closed loop on the physics that `evaluation.backend` names.

    Args:
        experiment: settings.
        parameters: from `command_parameters`.
        slots: episodes at once.
        threads: of C MuJoCo.

    Raises:
        BadInput: the devices are not there, or MJX or PyBullet cannot simulate the robot in this scene.
    """
    settings, control, scene = experiment.evaluation, experiment.control, make_scene(experiment.scene)
    guidance, planner = slowed(_guidance(experiment, scene), scene), _planner(experiment, scene, slots)
    robot = load_robot(experiment.robot)
    model = build_mujoco_model(scene, experiment.robot, control.control_dt / settings.substeps)
    set_solver(model, settings.physics.integrator, settings.physics.cone)
    controller, limit = make_controller(robot, control), np.array(experiment.expert.acceleration)
    perception: Perception = IDEAL
    if control.state == "estimated":
        perception = Estimated(experiment.sensors, Estimator(robot, experiment.sensors, control.control_dt))
    loop = ClosedLoop(scene, robot, collision_shapes(model), control, guidance, limit, controller, perception)
    draw, keys = _plants(experiment), (experiment.seed, streams.SENSORS, settings.seed)
    running: MujocoSlots | MjxSlots
    if settings.backend in ("mujoco", "pybullet"):
        physics: HostPhysics
        if settings.backend == "mujoco":
            physics = MujocoPhysics(model, slots, threads, substeps=settings.substeps)
        else:
            physics = BulletPhysics(model, slots, settings.substeps, settings.physics.rotor_reaction)
        running, device = MujocoSlots(batch_loop(loop), physics, parameters, planner), "cpu"
    else:
        devices = check_devices(settings)
        if draw is not None:  # one for all: experiment/check.py sees to it
            model, draw = plant_model(model, draw(np.zeros(1, int)).of(0)), None
        implementation: Implementation = "warp" if settings.backend == "mjx-warp" else "jax"
        initial = mjx_init(model, implementation, -(-slots // devices))
        running, device = MjxSlots(mjx_loop(loop, initial, devices), slots, parameters), jax.devices()[0].device_kind
    return Backend(
        running, robot, str(device), control.plan_dt, guidance, parameters, planner, scene.target, draw, keys
    )


def _plants(experiment: Experiment) -> Callable[[Int[np.ndarray, " n"]], Plant] | None:
    """What draws the robots of episodes; None where they are as the controller is told."""
    if experiment.plant == PlantSettings():
        return None
    stream = experiment.seed, streams.PLANTS, experiment.evaluation.seed
    return partial(draw_plants, experiment.plant, stream)


def check_backend(experiment: Experiment) -> None:
    """Refuse (BadInput) what `evaluation.backend` cannot simulate here, before any work."""
    check_devices(experiment.evaluation)
    if experiment.evaluation.backend == "pybullet":
        check_bullet(build_mujoco_model(make_scene(experiment.scene), experiment.robot, experiment.control.control_dt))


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


def _guidance(experiment: Experiment, scene: Scene) -> Guidance:
    """What the reference follows."""
    limits, policy = experiment.expert.limits, experiment.policy
    if experiment.evaluation.planner == "policy":
        return policy_guidance(make_policy(scene, limits, policy).command)
    if experiment.evaluation.planner != "straight":
        return path_guidance

    def straight(
        _: PyTree, pose: Float[Array, "4"], velocity: Float[Array, "4"], dt: float | Float[Array, ""]
    ) -> Float[Array, "4"]:
        error = pose + velocity * dt - jnp.asarray(scene.target, jnp.float32)
        error = error.at[3].set(wrap_angle(error[3], jnp))
        return braking_law(error, limits, policy.approach_rate).velocity

    return policy_guidance(straight)


def _planner(experiment: Experiment, scene: Scene, slots: int) -> ExpertPlanner | None:
    """The expert for the planners that ask it while the episodes run."""
    evaluation, expert = experiment.evaluation, experiment.expert
    if evaluation.planner in ("policy", "straight"):
        return None
    if evaluation.planner == "open_loop_2d":
        expert, scene = expert.model_copy(update={"dimensions": "2d"}), planar_scene(scene)
    interval = evaluation.replan_interval if evaluation.planner == "replan" else None
    return ExpertPlanner(scene, expert, slots, interval, experiment.control.lead_limit[0])
