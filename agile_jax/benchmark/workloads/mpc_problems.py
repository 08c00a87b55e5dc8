"""Problems of the MPC recorded from walking robots: calm ones as they come, hard ones from disturbed states.

Robots follow random commands (forward 0 to 1.2 m/s, sideways to 0.5 m/s, yaw rate to 1 rad/s, trunk height 0.165 to
0.30 m; half of the sideways and yaw rates and up to 0.8 m/s below 0.21 m) from standing, in C MuJoCo. A hard problem is
a calm one whose measured state is moved by up to 0.2 rad in roll and pitch, 0.8 m/s and 2 rad/s in each axis, its
memory and reference kept. Everything follows from the seed.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.benchmark.workloads.commands import ACCELERATION, Command, obey
from agile_jax.control import ControllerState, ControlSettings, Reference, make_controller
from agile_jax.control.mpc.problem import Qp
from agile_jax.progress import Progress, silent
from agile_jax.robot import RobotModel, RobotSettings, build_mujoco_model, load_robot, robot_state, standing_qpos
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics, Sensed
from agile_jax.simulation.mujoco_slots import as_float32
from agile_jax.simulation.outcome import trunk_pose
from agile_jax.simulation.reference import ReferenceState, plan_reference

SETTLED = 20  # plans before the first record
TILT, SPEED, RATE = 0.2, 0.8, 2.0  # of the disturbance [rad], [m/s], [rad/s]
PER_ROBOT = 20  # problems


class Problems(NamedTuple):
    """Batches of problems, leading axis (count,) on every leaf."""

    calm: Qp
    hard: Qp


def draw_commands(rng: np.random.Generator, robots: int) -> Command:
    """Of all robots."""
    height = rng.uniform(0.165, 0.30, robots)
    low = height < 0.21
    forward = np.minimum(rng.uniform(0, 1.2, robots), np.where(low, 0.8, np.inf))
    share = np.where(low, 0.5, 1.0)
    sideways, yaw_rate = share * rng.uniform(-0.5, 0.5, robots), share * rng.uniform(-1, 1, robots)
    return Command(np.stack([forward, sideways], -1), yaw_rate, height)


def disturbed(sensed: Sensed, rng: np.random.Generator) -> Sensed:
    """The same robots tilted and pushed."""
    qpos, qvel = np.array(sensed.qpos, float), np.array(sensed.qvel, float)
    roll, pitch = rng.uniform(-TILT / 2, TILT / 2, (2, len(qpos)))  # half angles
    w, x, y, z = qpos[:, 3:7].T
    # Quaternion products: first pitch, then roll, about the trunk's axes.
    w, x, y, z = (
        w * np.cos(pitch) - y * np.sin(pitch),
        x * np.cos(pitch) - z * np.sin(pitch),
        y * np.cos(pitch) + w * np.sin(pitch),
        z * np.cos(pitch) + x * np.sin(pitch),
    )
    turned = (
        w * np.cos(roll) - x * np.sin(roll),
        x * np.cos(roll) + w * np.sin(roll),
        y * np.cos(roll) + z * np.sin(roll),
        z * np.cos(roll) - y * np.sin(roll),
    )
    qpos[:, 3:7] = np.stack(turned, -1)
    qvel[:, :3] += rng.uniform(-SPEED, SPEED, (len(qpos), 3))
    qvel[:, 3:6] += rng.uniform(-RATE, RATE, (len(qpos), 3))
    return sensed._replace(qpos=qpos, qvel=qvel)


def record_problems(
    settings: ControlSettings, count: int = 1000, seed: int = 0, plans: int = 140, progress: Progress = silent
) -> Problems:
    """Walk, and record `count` calm problems and as many hard ones.

    Args:
        settings: of the controller.
        count: of problems; each robot gives 20.
        seed: of commands, moments and disturbances.
        plans: how long each robot walks, at least 40.
        progress: is told of the plans made.
    """
    rng = np.random.default_rng(seed)
    robots = -(-count // PER_ROBOT)
    commands = jax.tree.map(lambda values: jnp.asarray(values, jnp.float32), draw_commands(rng, robots))
    moments = set(rng.choice(np.arange(SETTLED, plans), PER_ROBOT, replace=False).tolist())
    robot = load_robot(RobotSettings())
    controller = make_controller(robot, settings)
    plan, problem, act = _compiled(robot, settings)
    model = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), settings.control_dt)
    qpos = np.tile(np.asarray(standing_qpos(robot, np.array([0.0, 0.0, 0.28, 0.0])), float), (robots, 1))
    calm, hard = [], []
    with MujocoPhysics(model, robots, 1) as physics:
        sensed = physics.reset(qpos)
        start = as_float32(sensed)
        state = jax.vmap(lambda s: controller.init(robot_state(s.qpos, s.qvel, s.foot_contact)))(start)
        leader = ReferenceState(jax.vmap(trunk_pose)(start), jnp.zeros((robots, 4)))
        active = np.ones(robots, bool)
        for k in range(plans):
            measured, before = as_float32(sensed), state
            leader, reference, state = plan(commands, leader, state, measured)
            if k in moments:
                calm.append(problem(before, measured, reference))
                hard.append(problem(before, as_float32(disturbed(sensed, rng)), reference))
            for _ in range(round(settings.plan_dt / settings.control_dt)):
                state, torque = act(state, as_float32(sensed))
                sensed = physics.step(np.asarray(torque, np.float64), active)
            progress(f"{robots} robots walk", k + 1, plans)
    return Problems(*(jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *some) for some in (calm, hard)))


def _compiled(robot: RobotModel, settings: ControlSettings) -> tuple[Any, Any, Any]:
    """`plan`, `problem` and `act` of a batch."""
    controller = make_controller(robot, settings)
    limit = jnp.asarray(ACCELERATION, jnp.float32)

    def plan(
        command: Command, leader: ReferenceState, state: ControllerState, sensed: Sensed
    ) -> tuple[ReferenceState, Reference, ControllerState]:
        measured = robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact)
        leader, reference = plan_reference(
            obey, (), command, leader, trunk_pose(sensed), jnp.float32(0.0), limit, settings
        )
        return leader, reference, controller.plan(state, measured, reference)

    def problem(state: ControllerState, sensed: Sensed, reference: Reference) -> Qp:
        return controller.problem(state, robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact), reference)

    def act(state: ControllerState, sensed: Sensed) -> tuple[ControllerState, jax.Array]:
        return controller.act(state, robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact))

    return jax.jit(jax.vmap(plan)), jax.jit(jax.vmap(problem)), jax.jit(jax.vmap(act))
