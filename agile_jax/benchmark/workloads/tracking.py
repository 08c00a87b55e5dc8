"""Robots that follow commands on flat ground, disturbed or not, in C MuJoCo.

Every episode starts standing at rest. The reference drives along the command under the acceleration limits, as it does
along a policy's field. Nothing that happens in the first second counts as an error, since the robot must first get
there; a fall counts at any time.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from agile_jax.benchmark.workloads.commands import Command, obey
from agile_jax.benchmark.workloads.disturbance import (
    Disturbance,
    Draws,
    SensorNoise,
    disturbed_plants,
    draw,
    next_drift,
    push_force,
    sense,
)
from agile_jax.benchmark.workloads.tally import Tally, columns, empty_tally, update_tally
from agile_jax.control import Controller, ControlSettings, Diagnostics
from agile_jax.progress import Progress, silent
from agile_jax.robot import Plant, RobotModel, RobotSettings, build_mujoco_model, standing_qpos, trunk_pose
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics, Sensed
from agile_jax.simulation.closed_loop import counted_while
from agile_jax.simulation.plan_cycle import on_host, plan_cycle
from agile_jax.simulation.reference import ReferenceState, plan_reference
from agile_jax.single_precision import as_float32

UNDISTURBED = Disturbance()
ACCELERATION = (1.5, 1.5, 1.0, 3.0)  # of the reference [m/s^2, rad/s^2]; the expert's default


class Tracked(NamedTuple):
    """State of one robot under a command."""

    command: Command
    draws: Draws
    controller: PyTree  # its state
    reference: ReferenceState
    diagnostics: Diagnostics  # of the controller; once the robot has fallen, its counts stay
    tally: Tally
    time: Float[Array, ""]  # [s]
    step: Int[Array, ""]
    drift: Float[Array, "3"]  # of the sensed orientation, in standard deviations
    torque: Float[Array, "12"]  # of the next step [Nm]


@dataclasses.dataclass(frozen=True, eq=False)
class Tracking:
    """The closed loop of one robot that follows a command, disturbances included."""

    robot: RobotModel
    settings: ControlSettings
    disturbance: Disturbance
    controller: Controller[PyTree]

    @property
    def noisy(self) -> bool:
        """Whether what is sensed is not the truth."""
        return self.disturbance.noise != SensorNoise()

    def init(self, sensed: Sensed, command: Command, draws: Draws) -> Tracked:
        """Begin: a robot at rest, its command, and what its disturbances drew."""
        state = self.controller.init(sensed.robot_state)
        return Tracked(
            command,
            draws,
            state,
            ReferenceState(trunk_pose(sensed.qpos, jnp), jnp.zeros(4)),
            self.controller.diagnostics(state),
            empty_tally(),
            jnp.float32(0.0),
            jnp.int32(0),
            jnp.zeros(3),
            jnp.zeros(12),
        )

    def plan(self, now: Tracked, sensed: Sensed) -> Tracked:
        """Advance the reference, and plan."""
        sensed = self._seen(now, sensed)
        reference_state, reference = plan_reference(
            lambda pose, velocity, time, dt: obey(now.command, pose, velocity, dt),
            now.reference,
            trunk_pose(sensed.qpos, jnp),
            now.time,
            jnp.array(ACCELERATION),
            self.settings,
        )
        state = self.controller.plan(now.controller, sensed.robot_state, reference)
        return now._replace(controller=state, reference=reference_state, diagnostics=self._diagnostics(now, state))

    def act(self, now: Tracked, sensed: Sensed) -> Tracked:
        """Count the last step, and set the torques of the next."""
        tally = update_tally(
            now.tally, now.time, sensed, now.command, now.torque, now.diagnostics.cone_violation, self.robot
        )
        seen = self._seen(now, sensed)
        state, torque = self.controller.act(now.controller, seen.robot_state)
        if self.disturbance.torque_noise:
            error = now.draws.torque_error + jax.random.normal(_key(now, 1), (12,))
            torque = torque * (1 + self.disturbance.torque_noise * error)
        drift = next_drift(now.drift, _key(now, 2), self.settings.control_dt) if self.noisy else now.drift
        return now._replace(
            controller=state,
            diagnostics=self._diagnostics(now, state),
            tally=tally,
            time=now.time + self.settings.control_dt,
            step=now.step + 1,
            drift=drift,
            torque=torque,
        )

    def _seen(self, now: Tracked, sensed: Sensed) -> Sensed:
        return sense(sensed, self.disturbance.noise, now.drift, _key(now, 0)) if self.noisy else sensed

    def _diagnostics(self, now: Tracked, state: PyTree) -> Diagnostics:
        upright = jnp.isinf(now.tally.fall_time)
        return counted_while(upright, self.controller.diagnostics(state), now.diagnostics)


def _key(now: Tracked, use: int) -> jax.Array:
    """Of the random numbers of one step, for one of four uses."""
    return jax.random.fold_in(now.draws.key, 4 * now.step + use)


@dataclasses.dataclass(frozen=True, eq=False)
class TrackingLoop:
    """The functions of a `Tracking` for n robots, compiled once. `plan` and `act` consume the states."""

    one: Tracking
    init: Callable[[Sensed, Command, Draws], Tracked]
    plan: Callable[[Tracked, Sensed], Tracked]
    act: Callable[[Tracked, Sensed], Tracked]

    @property
    def acts_per_plan(self) -> int:
        """Time steps between two plans."""
        return round(self.one.settings.plan_dt / self.one.settings.control_dt)

    def disturbed(self, disturbance: Disturbance) -> "TrackingLoop":
        """The loop under a disturbance, compiled anew only where it is one of the loop and not of the physics."""
        one, new = self.one, dataclasses.replace(self.one, disturbance=disturbance)
        if (one.disturbance.noise, one.disturbance.torque_noise) == (disturbance.noise, disturbance.torque_noise):
            return dataclasses.replace(self, one=new)
        return tracking_loop(one.robot, one.settings, disturbance, one.controller)


def tracking_loop(
    robot: RobotModel,
    settings: ControlSettings,
    disturbance: Disturbance,
    controller: Controller[PyTree],
) -> TrackingLoop:
    """Compile the closed loop; keep it, a second one would compile again.

    Args:
        robot: constants.
        settings: clocks, and the horizon and `lead_limit` of the reference.
        disturbance: of every episode.
        controller: that follows the commands.
    """
    one = Tracking(robot, settings, disturbance, controller)
    return TrackingLoop(
        one,
        jax.jit(jax.vmap(one.init)),
        jax.jit(jax.vmap(one.plan), donate_argnums=0),
        jax.jit(jax.vmap(one.act), donate_argnums=0),
    )


def track_commands(
    loop: TrackingLoop,
    commands: Command,
    duration: float,
    robot_settings: RobotSettings,
    *,
    start_height: float,
    seed: int = 0,
    threads: int = 2,
    progress: Progress = silent,
    watch: Callable[[Sensed, Tracked], None] | None = None,
    plants: Plant | None = None,
) -> dict[str, np.ndarray]:
    """Run one episode for each command, all at once.

    Args:
        loop: from `tracking_loop`.
        commands: n of them.
        duration: [s].
        robot_settings: of the robot.
        start_height: at which the robots stand first [m].
        seed: of the disturbances' draws.
        threads: of the physics.
        progress: is told of the plans done.
        watch: called after every plan period with what is sensed and the states.
        plants: the robots; by default the disturbance draws them.

    Returns:
        Columns of n: fall_time [s], velocity_rms [m/s], velocity_bias (n, 2), yaw_rate_rms, height_error_max [m],
        tilt_max [rad], cone_violation [N], torque_share, joint_violation [rad], and the controller's counts.
    """
    settings, disturbance = loop.one.settings, loop.one.disturbance
    draws = draw(len(commands.yaw_rate), seed)
    model = build_mujoco_model(make_scene(SceneSettings()), robot_settings, settings.control_dt)
    start = standing_qpos(loop.one.robot, np.array([0.0, 0.0, start_height, 0.0], np.float32))
    plans, count = round(duration / settings.plan_dt), len(commands.yaw_rate)
    active = np.ones(count, bool)
    with MujocoPhysics(model, count, threads) as physics:

        def step(world: tuple[int, Sensed], states: Tracked) -> tuple[tuple[int, Sensed], Sensed]:
            steps, before = world
            push = push_force(disturbance, draws, steps * settings.control_dt, before.qpos)
            sensed = physics.step(np.asarray(states.torque, np.float64), active, push)
            return (steps + 1, sensed), sensed

        plants = disturbed_plants(disturbance, draws) if plants is None else plants
        sensed = physics.reset(np.repeat(np.asarray(start)[None], count, 0), None, plants)
        world, states = (0, sensed), loop.init(sensed, as_float32(commands), draws)
        for k in range(plans):
            world, states, sensed = plan_cycle(
                loop.plan, loop.act, step, world, states, sensed, loop.acts_per_plan, on_host
            )
            active &= ~np.isfinite(np.asarray(states.tally.fall_time))
            if watch is not None:
                watch(sensed, states)
            progress("tracking", k + 1, plans)
    return columns(states.tally, states.diagnostics.counts)
