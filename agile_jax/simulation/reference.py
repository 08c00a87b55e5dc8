"""From what is followed, a policy or a path, to the MPC's reference.

The reference is a pose that follows the policy under the expert's acceleration limits, starting from the measured
state and held within a leash of it: it can pull the robot (the position error of a robot that lags), but never run
away from it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control import ControlSettings, Reference
from agile_jax.geometry import wrap_angle
from agile_jax.policy.velocity_tracker import track

# (parameters, path, pose (4,), velocity (4,), time (), dt) -> wanted velocity after dt (4,). A policy ignores path and
# time; what follows a path ignores the parameters.
Command = Callable[[Any, Any, jax.Array, jax.Array, jax.Array, float], jax.Array]


class ReferenceState(NamedTuple):
    """Where the reference is, and how fast."""

    pose: jax.Array  # (4,) [m, rad]
    velocity: jax.Array  # (4,) [m/s, rad/s]


def policy_command(command: Callable[[Any, jax.Array, jax.Array, float], jax.Array]) -> Command:
    """The command of a policy: (parameters, pose, velocity, dt) -> wanted velocity after dt."""
    return lambda parameters, path, pose, velocity, time, dt: command(parameters, pose, velocity, dt)


def drive(
    command: Command,
    parameters: Any,
    path: Any,
    state: ReferenceState,
    time: jax.Array,
    acceleration_limit: jax.Array,
    dt: float,
) -> ReferenceState:
    """One step along what is followed.

    Args:
        command, parameters, path: what to follow.
        state: pose and velocity.
        time: () [s].
        acceleration_limit: per axis, shape (4,).
        dt: [s].
    """
    wanted = command(parameters, path, state.pose, state.velocity, time, dt)
    velocity = track(wanted, state.velocity, acceleration_limit, dt)
    return ReferenceState(state.pose + velocity * dt, velocity)


def hold_within_leash(state: ReferenceState, pose: jax.Array, settings: ControlSettings) -> ReferenceState:
    """Pull the reference back to within the leash of the measured pose (4,)."""
    planar, height, yaw = settings.leash
    lead = state.pose - pose
    lead = lead.at[3].set(wrap_angle(lead[3], jnp))
    distance = jnp.sqrt(jnp.sum(lead[:2] ** 2) + 1e-12)
    lead_planar = lead[:2] * jnp.minimum(1.0, planar / distance)
    lead = jnp.concatenate(
        [lead_planar, jnp.clip(lead[2:3], -height, height), jnp.clip(lead[3:], -yaw, yaw)],
    )
    return state._replace(pose=pose + lead)


def plan_reference(
    command: Command,
    parameters: Any,
    path: Any,
    state: ReferenceState,
    pose: jax.Array,
    time: jax.Array,
    acceleration_limit: jax.Array,
    settings: ControlSettings,
) -> tuple[ReferenceState, Reference]:
    """Advance the reference by one planning step and preview it over the MPC's horizon.

    Args:
        command, parameters, path: what to follow.
        state: of the reference at the last plan.
        pose: measured [x, y, z, yaw] of the trunk, shape (4,) [m, rad].
        time: () on the clock of the episode [s].
        acceleration_limit: per axis, shape (4,).
        settings: clocks and leash.

    Returns:
        The new state, and the reference of the horizon.
    """
    state = hold_within_leash(state, pose, settings)
    now = drive(command, parameters, path, state, time, acceleration_limit, settings.plan_dt)

    def step(carry: ReferenceState, k: jax.Array) -> tuple[ReferenceState, ReferenceState]:
        then = time + settings.plan_dt + k * settings.mpc.mpc_dt
        following = drive(command, parameters, path, carry, then, acceleration_limit, settings.mpc.mpc_dt)
        return following, following

    _, ahead = jax.lax.scan(step, now, jnp.arange(settings.mpc.horizon, dtype=jnp.float32))
    return now, Reference(now.pose, now.velocity, ahead.pose, ahead.velocity)
