"""Problems of the MPC recorded from walking robots: calm ones as they come, hard ones from disturbed states.

Robots follow random commands (forward 0 to 1.2 m/s, sideways to 0.5 m/s, yaw rate to 1 rad/s, trunk height 0.165 to
0.30 m; half of the sideways and yaw rates and up to 0.8 m/s below 0.21 m) from standing, in C MuJoCo. A hard problem is
a calm one whose measured state is moved by up to 0.2 rad in roll and pitch, 0.8 m/s and 2 rad/s in each axis, its
memory and reference kept. Everything follows from the seed.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.benchmark.workloads.commands import Command
from agile_jax.benchmark.workloads.disturbance import draw
from agile_jax.benchmark.workloads.tracking import UNDISTURBED, Tracked, tracking_loop
from agile_jax.control import (
    ControllerState,
    ControlSettings,
    Diagnostics,
    MpcController,
    Reference,
    make_mpc_controller,
)
from agile_jax.control.mpc.problem import Qp
from agile_jax.progress import Progress, silent
from agile_jax.robot import RobotSettings, RobotState, build_mujoco_model, load_robot, standing_qpos
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics, Sensed
from agile_jax.simulation.plan_cycle import on_host, plan_cycle
from agile_jax.single_precision import as_float32

SETTLED = 20  # plans before the first record
TILT, SPEED, RATE = 0.2, 0.8, 2.0  # of the disturbance [rad], [m/s], [rad/s]
PER_ROBOT = 20  # problems


class Problems(NamedTuple):
    """Batches of problems, leading axis (count,) on every leaf."""

    calm: Qp
    hard: Qp


class RecordedState(NamedTuple):
    """The state of a controller, and what its last plan was made from."""

    now: ControllerState
    before: ControllerState
    reference: Reference


class RecordingController:
    """The library's controller, which remembers what it planned from: a `Controller` of its own."""

    def __init__(self, controller: MpcController) -> None:
        self.controller = controller

    def init(self, robot_state: RobotState) -> RecordedState:
        """Begin, with nothing planned."""
        state = self.controller.init(robot_state)
        still, nodes = jnp.zeros(4), jnp.zeros((self.controller.settings.mpc.horizon, 4))
        return RecordedState(state, state, Reference(still, still, nodes, nodes))

    def plan(self, state: RecordedState, robot_state: RobotState, reference: Reference) -> RecordedState:
        """Plan, and remember."""
        return RecordedState(self.controller.plan(state.now, robot_state, reference), state.now, reference)

    def act(self, state: RecordedState, robot_state: RobotState) -> tuple[RecordedState, jax.Array]:
        """Act."""
        now, torque = self.controller.act(state.now, robot_state)
        return state._replace(now=now), torque

    def diagnostics(self, state: RecordedState) -> Diagnostics:
        """Of the controller."""
        return self.controller.diagnostics(state.now)

    def problem(self, state: RecordedState, sensed: Sensed) -> Qp:
        """The problem of the last plan, had this been sensed then."""
        return self.controller.problem(state.before, sensed.robot_state, state.reference)


def draw_commands(rng: np.random.Generator, robots: int) -> Command:
    """Commands of all robots."""
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
    commands = as_float32(draw_commands(rng, robots))
    moments = set(rng.choice(np.arange(SETTLED, plans), PER_ROBOT, replace=False).tolist())
    robot = load_robot(RobotSettings())
    controller = RecordingController(make_mpc_controller(robot, settings))
    loop, problem = tracking_loop(robot, settings, UNDISTURBED, controller), jax.jit(jax.vmap(controller.problem))
    model = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), settings.control_dt)
    qpos = np.tile(np.asarray(standing_qpos(robot, np.array([0.0, 0.0, 0.28, 0.0])), float), (robots, 1))
    calm, hard = [], []
    with MujocoPhysics(model, robots, 1) as physics:

        def step(world: None, states: Tracked) -> tuple[None, Sensed]:
            return world, physics.step(np.asarray(states.torque, np.float64))

        sensed = physics.reset(qpos)
        states = loop.init(sensed, commands, draw(robots, seed))
        for k in range(plans):
            measured = sensed
            _, states, sensed = plan_cycle(loop.plan, loop.act, step, None, states, sensed, loop.acts_per_plan, on_host)
            if k in moments:
                calm.append(problem(states.controller, measured))
                hard.append(problem(states.controller, disturbed(measured, rng)))
            progress(f"{robots} robots walk", k + 1, plans)
    return Problems(*(jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *some) for some in (calm, hard)))
