"""How an episode ends, and what is measured on the way. One definition for both physics backends.

An episode succeeds when, within its time limit, the trunk has stayed for 0.5 s within 0.10 m of the target in the
plane, 0.05 m in height and 0.2 rad in yaw, while at no physics step any part of the robot touched an obstacle, the
trunk or a thigh touched the floor, the trunk tilted past 60 degrees, or a state was not finite.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot import trunk_pose
from agile_jax.scene import Scene, clearance, within_tolerance
from agile_jax.simulation.sensed import Sensed

RUNNING, SUCCESS, COLLISION, FALL, TIMEOUT, UNSTABLE = -1, 0, 1, 2, 3, 4
OUTCOME_NAMES = ("success", "collision", "fall", "timeout", "unstable")

STAY = 0.5  # [s]
LARGEST_TILT_COSINE = 0.5  # cos 60 degrees
LARGEST_SPEED = 1e3  # of any coordinate [m/s, rad/s]; beyond it the simulation has diverged


class Outcome(NamedTuple):
    """State of one episode's judgement; sums are over its physics steps while it runs."""

    status: Int[Array, ""]  # RUNNING or one of the outcomes
    time: Float[Array, ""]  # [s]; the time of the end once it has ended
    time_limit: Float[Array, ""]  # [s]
    inside_since: Float[Array, ""]  # time at which the trunk entered the target's tolerance [s]; infinity outside it
    min_clearance: Float[Array, ""]  # of the robot's collision geometry [m]
    min_envelope_clearance: Float[Array, ""]  # of the torso's envelope, which plans keep clear [m]
    min_self_clearance: Float[Array, ""]  # of the legs to the trunk and to each other [m]
    planar_error: Float[Array, ""]  # distance to the target in the plane [m]
    velocity_error_sum: Float[Array, ""]  # [m^2/s^2]
    saturated: Float[Array, ""]  # joints at their torque limit, summed over steps
    work: Float[Array, ""]  # positive mechanical work of the joints [J]
    distance: Float[Array, ""]  # travelled in the plane [m]
    steps: Int[Array, ""]


def init_outcome(time_limit: Float[Array, ""]) -> Outcome:
    """An episode about to begin, with a time limit [s]."""
    zero, infinity = jnp.float32(0.0), jnp.float32(jnp.inf)
    return Outcome(
        status=jnp.int32(RUNNING),
        time=zero,
        time_limit=time_limit,
        inside_since=infinity,
        min_clearance=infinity,
        min_envelope_clearance=infinity,
        min_self_clearance=infinity,
        planar_error=zero,
        velocity_error_sum=zero,
        saturated=zero,
        work=zero,
        distance=zero,
        steps=jnp.int32(0),
    )


def update_outcome(
    outcome: Outcome,
    sensed: Sensed,
    scene: Scene,
    nearest: Float[Array, ""],
    own_nearest: Float[Array, ""],
    reference_velocity: Float[Array, "2"],
    torque: Float[Array, "12"],
    torque_limit: Float[Array, "12"],
    dt: float,
) -> Outcome:
    """Judge one physics step. An episode that has ended does not change.

    Args:
        outcome: so far.
        sensed: after the step.
        scene: target and obstacles.
        nearest: clearance of the robot's collision geometry [m].
        own_nearest: of its legs to its trunk and to each other, which no outcome depends on [m].
        reference_velocity: of the trunk in the plane [m/s].
        torque: during the step [Nm].
        torque_limit: [Nm].
        dt: of the step [s].
    """
    finite = jnp.isfinite(sensed.qpos).all() & (jnp.abs(sensed.qvel) < LARGEST_SPEED).all()
    pose = trunk_pose(sensed.qpos, jnp)
    error = pose - jnp.asarray(scene.target, jnp.float32)
    planar = jnp.sqrt(jnp.sum(error[:2] ** 2))
    time = outcome.time + dt
    inside_since = jnp.where(within_tolerance(error, jnp), jnp.minimum(outcome.inside_since, time), jnp.inf)
    stayed = time - inside_since >= STAY - dt / 2
    up = quaternion_to_matrix(sensed.qpos[3:7], jnp)[2, 2]
    fallen = sensed.floor_contact | (up < LARGEST_TILT_COSINE)
    status = jnp.select(
        [~finite, sensed.obstacle_contact, fallen, stayed, time >= outcome.time_limit],
        [jnp.int32(code) for code in (UNSTABLE, COLLISION, FALL, SUCCESS, TIMEOUT)],
        jnp.int32(RUNNING),
    )
    new = Outcome(
        status=status,
        time=time,
        time_limit=outcome.time_limit,
        inside_since=inside_since,
        min_clearance=jnp.minimum(outcome.min_clearance, nearest),
        min_envelope_clearance=jnp.minimum(outcome.min_envelope_clearance, clearance(scene, pose, jnp)),
        min_self_clearance=jnp.minimum(outcome.min_self_clearance, own_nearest),
        planar_error=planar,
        velocity_error_sum=outcome.velocity_error_sum + jnp.sum((sensed.qvel[:2] - reference_velocity) ** 2),
        saturated=outcome.saturated + jnp.sum(jnp.abs(torque) >= torque_limit * 0.9999).astype(jnp.float32),
        work=outcome.work + jnp.sum(jnp.maximum(torque * sensed.qvel[6:], 0.0)) * dt,
        distance=outcome.distance + jnp.sqrt(jnp.sum(sensed.qvel[:2] ** 2)) * dt,
        steps=outcome.steps + 1,
    )
    running = outcome.status == RUNNING
    return jax.tree.map(lambda after, before: jnp.where(running, after, before), new, outcome)
