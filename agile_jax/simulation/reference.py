"""From the policy to the MPC's reference.

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
from agile_jax.policy.tracker import track

# The policy's: (parameters, pose (4,), velocity (4,), dt) -> wanted velocity after dt (4,).
Command = Callable[[Any, jax.Array, jax.Array, float], jax.Array]


class ReferenceState(NamedTuple):
    """Where the reference is, and how fast."""

    pose: jax.Array  # (4,) [m, rad]
    velocity: jax.Array  # (4,) [m/s, rad/s]


def drive(
    command: Command, parameters: Any, state: ReferenceState, acceleration_limit: jax.Array, dt: float
) -> ReferenceState:
    """One step along the policy's command.

    Args:
        command, parameters: the policy.
        state: pose and velocity.
        acceleration_limit: per axis, shape (4,).
        dt: [s].
    """
    wanted = command(parameters, state.pose, state.velocity, dt)
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
    state: ReferenceState,
    pose: jax.Array,
    acceleration_limit: jax.Array,
    settings: ControlSettings,
) -> tuple[ReferenceState, Reference]:
    """Advance the reference by one planning step and preview it over the MPC's horizon.

    Args:
        command, parameters: the policy.
        state: of the reference at the last plan.
        pose: measured [x, y, z, yaw] of the trunk, shape (4,) [m, rad].
        acceleration_limit: per axis, shape (4,).
        settings: clocks and leash.

    Returns:
        The new state, and the reference of the horizon.
    """
    state = hold_within_leash(state, pose, settings)
    now = drive(command, parameters, state, acceleration_limit, settings.plan_dt)

    def step(carry: ReferenceState, _: None) -> tuple[ReferenceState, ReferenceState]:
        following = drive(command, parameters, carry, acceleration_limit, settings.mpc.mpc_dt)
        return following, following

    _, ahead = jax.lax.scan(step, now, None, length=settings.mpc.horizon)
    return now, Reference(now.pose, now.velocity, ahead.pose, ahead.velocity)
