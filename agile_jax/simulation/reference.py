"""From what is followed, a policy or a path, to the MPC's reference.

The reference is a pose that follows the guidance under the expert's acceleration limits, starting from the measured
state and limited in its lead over it: it can pull the robot (the position error of a robot that lags), but never run
away from it.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from agile_jax.control import ControlSettings, Reference
from agile_jax.geometry import wrap_angle
from agile_jax.policy.velocity_tracker import track
from agile_jax.scene import Scene, within_top_speed
from agile_jax.simulation.paths import TimedPath

Guide = Callable[[Float[Array, "4"], Float[Array, "4"], Float[Array, ""], float], Float[Array, "4"]]
"""A `Guidance` with its parameters and path: (pose, velocity, time, dt) of the reference to the velocity wanted."""
CommandFunction = Callable[[PyTree, Float[Array, "4"], Float[Array, "4"], float], Float[Array, "4"]]
"""`Policy.command`: (parameters, pose, velocity, dt) to the velocity that is wanted a step later [m/s, rad/s]."""


@runtime_checkable
class Guidance(Protocol):
    """What a reference follows."""

    def __call__(
        self,
        parameters: PyTree,
        path: TimedPath | None,
        pose: Float[Array, "4"],
        velocity: Float[Array, "4"],
        time: Float[Array, ""],
        dt: float,
    ) -> Float[Array, "4"]:
        """The velocity that is wanted a step later [m/s, rad/s].

        Args:
            parameters: of a policy; what follows a path ignores them.
            path: to follow; a policy ignores it, and the time.
            pose, velocity: of the reference [m, rad], [m/s, rad/s].
            time: on the clock of the episode [s].
            dt: of the step [s].
        """


class ReferenceState(NamedTuple):
    """Where the reference of one robot is, and how fast."""

    pose: Float[Array, "4"]  # [m, rad]
    velocity: Float[Array, "4"]  # [m/s, rad/s]


def policy_guidance(command: CommandFunction) -> Guidance:
    """The guidance of a policy, or of another function of the reference alone, from its `command`."""
    return lambda parameters, path, pose, velocity, time, dt: command(parameters, pose, velocity, dt)


def slowed(guidance: Guidance, scene: Scene) -> Guidance:
    """The guidance, no faster than the legs allow at the height of the reference."""

    def slower(
        parameters: PyTree,
        path: TimedPath | None,
        pose: Float[Array, "4"],
        velocity: Float[Array, "4"],
        time: Float[Array, ""],
        dt: float,
    ) -> Float[Array, "4"]:
        wanted = guidance(parameters, path, pose, velocity, time, dt)
        return within_top_speed(scene, pose[2] + velocity[2] * dt, wanted, jnp)

    return slower


def drive(
    guide: Guide,
    state: ReferenceState,
    time: Float[Array, ""],
    acceleration_limit: Float[Array, "4"],
    dt: float,
) -> ReferenceState:
    """One step along what is followed.

    Args:
        guide: what to follow.
        state: pose and velocity.
        time: on the clock of the episode [s].
        acceleration_limit: per axis [m/s^2, rad/s^2].
        dt: [s].
    """
    wanted = guide(state.pose, state.velocity, time, dt)
    velocity = track(wanted, state.velocity, acceleration_limit, dt)
    return ReferenceState(state.pose + velocity * dt, velocity)


def limit_lead(state: ReferenceState, pose: Float[Array, "4"], settings: ControlSettings) -> ReferenceState:
    """Pull the reference back to within `settings.lead_limit` of the measured pose [m, rad]."""
    planar, height, yaw = settings.lead_limit
    lead = state.pose - pose
    lead = lead.at[3].set(wrap_angle(lead[3], jnp))
    distance = jnp.sqrt(jnp.sum(lead[:2] ** 2) + 1e-12)
    lead_planar = lead[:2] * jnp.minimum(1.0, planar / distance)
    lead = jnp.concatenate(
        [lead_planar, jnp.clip(lead[2:3], -height, height), jnp.clip(lead[3:], -yaw, yaw)],
    )
    return state._replace(pose=pose + lead)


def plan_reference(
    guide: Guide,
    state: ReferenceState,
    pose: Float[Array, "4"],
    time: Float[Array, ""],
    acceleration_limit: Float[Array, "4"],
    settings: ControlSettings,
) -> tuple[ReferenceState, Reference]:
    """Advance the reference by one planning step and preview it over the MPC's horizon.

    Args:
        guide: what to follow.
        state: of the reference at the last plan.
        pose: measured [x, y, z, yaw] of the trunk [m, rad].
        time: on the clock of the episode [s].
        acceleration_limit: per axis [m/s^2, rad/s^2].
        settings: clocks and `lead_limit`.

    Returns:
        The new state, and the reference of the horizon.
    """
    state = limit_lead(state, pose, settings)
    now = drive(guide, state, time, acceleration_limit, settings.plan_dt)

    def step(carry: ReferenceState, k: jax.Array) -> tuple[ReferenceState, ReferenceState]:
        then = time + settings.plan_dt + k * settings.mpc.mpc_dt
        following = drive(guide, carry, then, acceleration_limit, settings.mpc.mpc_dt)
        return following, following

    _, ahead = jax.lax.scan(step, now, jnp.arange(settings.mpc.horizon, dtype=jnp.float32))
    return now, Reference(now.pose, now.velocity, ahead.pose, ahead.velocity)
