"""How well the controller follows commands on flat ground, disturbed or not, in C MuJoCo.

Every episode starts standing at rest. A command is a velocity of the trunk along its own axes, a yaw rate and a height;
the reference drives along it under the acceleration limits, as it does along a policy's field. Nothing that happens in
the first second counts as an error, since the robot must first get there; a fall counts at any time.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.benchmark.workloads.disturbance import (
    Disturbance,
    disturbed_models,
    draw,
    next_drift,
    push_force,
    sense,
)
from agile_jax.control import ControllerState, ControlSettings, keep_counts, make_controller
from agile_jax.geometry import quaternion_to_matrix, rotation_2d
from agile_jax.progress import Progress, silent
from agile_jax.robot import RobotModel, RobotSettings, build_mujoco_model, load_robot, robot_state, standing_qpos
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics, Sensed
from agile_jax.simulation.mujoco_slots import as_float32
from agile_jax.simulation.outcome import LARGEST_SPEED, LARGEST_TILT_COSINE, trunk_pose
from agile_jax.simulation.reference import ReferenceState, plan_reference

SETTLING = 1.0  # what is not counted at the beginning [s]
HEIGHT_RATE = 4.0  # climb or crouch per height error [1/s]
CLIMB = 0.3  # fastest [m/s]
UNDISTURBED = Disturbance()
ACCELERATION = (1.5, 1.5, 1.0, 3.0)  # of the reference [m/s^2, rad/s^2]; the expert's default


class Command(NamedTuple):
    """Leading axis n for n episodes."""

    velocity: Any  # (2,) forward and to the left [m/s]
    yaw_rate: Any  # () [rad/s]
    height: Any  # () of the trunk's origin [m]


class Tally(NamedTuple):
    """Sums and extremes over the steps of one episode, after the settling time unless said otherwise."""

    fall_time: jax.Array  # () [s], infinity without a fall; over all steps
    steps: jax.Array  # ()
    velocity_error_sq: jax.Array  # () sum, in the plane [m^2/s^2]
    velocity_error: jax.Array  # (2,) sum, forward and to the left [m/s]
    yaw_rate_error_sq: jax.Array  # () sum [rad^2/s^2]
    height_error_max: jax.Array  # () largest absolute [m]
    tilt_max: jax.Array  # () [rad]
    cone_violation: jax.Array  # () |f_t| - mu f_n of the planned forces, largest over all steps [N]
    torque_share: jax.Array  # () |torque| over its limit, largest over all steps
    joint_violation: jax.Array  # () past a limit, largest over all steps [rad]


class Tracked(NamedTuple):
    """State of one closed loop under a command."""

    controller: ControllerState
    reference: ReferenceState
    tally: Tally
    time: jax.Array  # () [s]
    step: jax.Array  # () int32
    drift: jax.Array  # (3,)
    queue: jax.Array  # (delay + 1, 12) torques on their way [Nm]


class Loop(NamedTuple):
    """Batched, compiled functions."""

    init: Callable[[Sensed], Tracked]
    plan: Callable[[Tracked, Sensed, Command, Any], Tracked]
    act: Callable[[Tracked, Sensed, Command, Any], Tracked]


def obey(_: Any, command: Command, pose: jax.Array, velocity: jax.Array, time: jax.Array, dt: float) -> jax.Array:
    """Velocity (4,) in the world that obeys a command from a pose (4,) on; what a reference follows."""
    pose = pose + velocity * dt
    planar = rotation_2d(pose[3], jnp) @ command.velocity
    climb = jnp.clip(HEIGHT_RATE * (command.height - pose[2]), -CLIMB, CLIMB)
    return jnp.stack([planar[0], planar[1], climb, command.yaw_rate])


def tracking_loop(robot: RobotModel, settings: ControlSettings, disturbance: Disturbance) -> Loop:
    """Compose controller, reference and disturbances; keep it, a second one would compile again."""
    controller = make_controller(robot, settings)
    acceleration = jnp.array(ACCELERATION)
    delay = round(disturbance.delay / settings.control_dt)
    noisy = disturbance.noise != type(disturbance.noise)()

    def seen(sensed: Sensed, state: Tracked, draws: Any) -> Sensed:
        if not noisy:
            return sensed
        return sense(sensed, disturbance.noise, state.drift, jax.random.fold_in(draws.key, 4 * state.step))

    def init(sensed: Sensed) -> Tracked:
        state = robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact)
        reference = ReferenceState(trunk_pose(sensed), jnp.zeros(4))
        return Tracked(
            controller.init(state),
            reference,
            empty_tally(),
            jnp.float32(0.0),
            jnp.int32(0),
            jnp.zeros(3),
            jnp.zeros((delay + 1, 12)),
        )

    def plan(state: Tracked, sensed: Sensed, command: Command, draws: Any) -> Tracked:
        sensed = seen(sensed, state, draws)
        reference_state, reference = plan_reference(
            obey, (), command, state.reference, trunk_pose(sensed), state.time, acceleration, settings
        )
        planned = controller.plan(
            state.controller, robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact), reference
        )
        return state._replace(controller=counting(state, planned), reference=reference_state)

    def act(state: Tracked, sensed: Sensed, command: Command, draws: Any) -> Tracked:
        tally = update_tally(state, sensed, command, robot, settings)
        felt = seen(sensed, state, draws)
        controlled, torque = controller.act(state.controller, robot_state(felt.qpos, felt.qvel, felt.foot_contact))
        if disturbance.torque_noise:
            key = jax.random.fold_in(draws.key, 4 * state.step + 1)
            error = draws.torque_error + jax.random.normal(key, (12,))
            torque = torque * (1 + disturbance.torque_noise * error)
        drift = state.drift
        if noisy:
            drift = next_drift(drift, jax.random.fold_in(draws.key, 4 * state.step + 2), settings.control_dt)
        queue = jnp.concatenate([state.queue[1:], torque[None]])
        return Tracked(
            counting(state, controlled),
            state.reference,
            tally,
            state.time + settings.control_dt,
            state.step + 1,
            drift,
            queue,
        )

    def counting(state: Tracked, new: ControllerState) -> ControllerState:
        """The controller's new state; once the robot has fallen, its counts stay."""
        upright = jnp.isinf(state.tally.fall_time)
        return new._replace(diagnostics=keep_counts(upright, new.diagnostics, state.controller.diagnostics))

    return Loop(
        jax.jit(jax.vmap(init)),
        jax.jit(jax.vmap(plan), donate_argnums=0),
        jax.jit(jax.vmap(act), donate_argnums=0),
    )


def empty_tally() -> Tally:
    """Before the first step."""
    zero = jnp.float32(0.0)
    return Tally(jnp.float32(jnp.inf), zero, zero, jnp.zeros(2), zero, zero, zero, zero, zero, zero)


def update_tally(
    state: Tracked, sensed: Sensed, command: Command, robot: RobotModel, settings: ControlSettings
) -> Tally:
    """Count one physics step: the state after it, and the torques and forces that were commanded for it."""
    old = state.tally
    R = quaternion_to_matrix(sensed.qpos[3:7], jnp)
    finite = jnp.isfinite(sensed.qpos).all() & (jnp.abs(sensed.qvel) < LARGEST_SPEED).all()
    fallen = ~finite | sensed.floor_contact | (R[2, 2] < LARGEST_TILT_COSINE)
    pose = trunk_pose(sensed)
    error = sensed.qvel[:2] @ rotation_2d(pose[3], jnp) - command.velocity
    yaw_rate = (R @ sensed.qvel[3:6])[2]
    counted = state.time >= SETTLING
    forces = state.controller.forces_world
    cone = jnp.hypot(forces[:, 0], forces[:, 1]) - settings.mpc.friction * forces[:, 2]
    torque = jnp.abs(state.queue[0]) / jnp.asarray(robot.torque_limit, jnp.float32)
    joints = sensed.qpos[7:]
    past = jnp.maximum(joints - jnp.asarray(robot.joint_upper), jnp.asarray(robot.joint_lower) - joints)
    new = Tally(
        fall_time=jnp.where(fallen, jnp.minimum(old.fall_time, state.time), old.fall_time),
        steps=old.steps + counted,
        velocity_error_sq=old.velocity_error_sq + counted * jnp.sum(error**2),
        velocity_error=old.velocity_error + counted * error,
        yaw_rate_error_sq=old.yaw_rate_error_sq + counted * (yaw_rate - command.yaw_rate) ** 2,
        height_error_max=jnp.maximum(old.height_error_max, counted * jnp.abs(pose[2] - command.height)),
        tilt_max=jnp.maximum(old.tilt_max, counted * jnp.arccos(jnp.clip(R[2, 2], -1.0, 1.0))),
        cone_violation=jnp.maximum(old.cone_violation, cone.max()),
        torque_share=jnp.maximum(old.torque_share, torque.max()),
        joint_violation=jnp.maximum(old.joint_violation, past.max()),
    )
    return jax.tree.map(lambda after, before: jnp.where(old.fall_time < jnp.inf, before, after), new, old)


def track_commands(
    commands: Command,
    duration: float,
    settings: ControlSettings,
    robot_settings: RobotSettings,
    disturbance: Disturbance = UNDISTURBED,
    *,
    start_height: float,
    seed: int = 0,
    threads: int = 2,
    loop: Loop | None = None,
    progress: Progress = silent,
    watch: Callable[[Sensed, Tracked], None] | None = None,
) -> dict[str, np.ndarray]:
    """Run one episode for each command, all at once.

    Args:
        commands: n of them.
        duration: [s].
        settings: of the controller.
        robot_settings: which robot.
        disturbance: of every episode.
        start_height: at which the robots stand first [m].
        seed: of the disturbances' draws.
        threads: of the physics.
        loop: from `tracking_loop` with the same settings, if it is there already.
        progress: is told of the plans done.
        watch: called after every plan period with what is sensed and the states.

    Returns:
        Columns of n: fall_time [s], velocity_rms [m/s], velocity_bias (n, 2), yaw_rate_rms, height_error_max [m],
        tilt_max [rad], cone_violation [N], torque_share, joint_violation [rad], and the
        controller's counts.
    """
    count = len(commands.yaw_rate)
    robot = load_robot(robot_settings)
    draws = draw(count, seed)
    model = build_mujoco_model(make_scene(SceneSettings()), robot_settings, settings.control_dt)
    loop = loop or tracking_loop(robot, settings, disturbance)
    start = standing_qpos(robot, np.array([0.0, 0.0, start_height, 0.0], np.float32))
    commands = Command(*(jnp.asarray(column, jnp.float32) for column in commands))
    seen_draws = jax.tree.map(jnp.asarray, draws)
    plans = round(duration / settings.plan_dt)
    acts = round(settings.plan_dt / settings.control_dt)
    with MujocoPhysics(model, count, threads, disturbed_models(model, disturbance, draws)) as physics:
        sensed = physics.reset(np.repeat(np.asarray(start)[None], count, 0))
        states = loop.init(as_float32(sensed))
        active = np.ones(count, bool)
        for k in range(plans):
            states = loop.plan(states, as_float32(sensed), commands, seen_draws)
            for j in range(acts):
                states = loop.act(states, as_float32(sensed), commands, seen_draws)
                time = (k * acts + j) * settings.control_dt
                push = push_force(disturbance, draws, time, sensed.qpos)
                sensed = physics.step(np.asarray(states.queue[:, 0], np.float64), active, push)
            active &= ~np.isfinite(np.asarray(states.tally.fall_time))
            if watch is not None:
                watch(sensed, states)
            progress("tracking", k + 1, plans)
    return columns(states)


def columns(states: Tracked) -> dict[str, np.ndarray]:
    """One entry an episode."""
    tally = jax.tree.map(np.asarray, states.tally)
    steps = np.maximum(tally.steps, 1)
    return {
        "fall_time": tally.fall_time,
        "velocity_rms": np.sqrt(tally.velocity_error_sq / steps),
        "velocity_bias": tally.velocity_error / steps[:, None],
        "yaw_rate_rms": np.sqrt(tally.yaw_rate_error_sq / steps),
        "height_error_max": tally.height_error_max,
        "tilt_max": tally.tilt_max,
        "cone_violation": tally.cone_violation,
        "torque_share": tally.torque_share,
        "joint_violation": tally.joint_violation,
        **{name: np.asarray(values) for name, values in states.controller.diagnostics.counts._asdict().items()},
    }


def random_commands(
    count: int,
    seed: int,
    forward: tuple[float, float],
    sideways: float,
    yaw_rate: float,
    height: float,
) -> Command:
    """Uniform commands: the first k of n are the same whatever n."""
    rows = np.array([np.random.default_rng((seed, 7_003, i)).uniform(size=3) for i in range(count)])
    low, high = forward
    velocity = np.stack([low + (high - low) * rows[:, 0], sideways * (2 * rows[:, 1] - 1)], -1)
    return Command(velocity, yaw_rate * (2 * rows[:, 2] - 1), np.full(count, height))
