"""When the robot stands instead of stepping: its reference hardly moves, and it stands over its feet and still."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from agile_jax.arrays import AnyArray
from agile_jax.control.body import Body, Reference
from agile_jax.geometry import wrap_angle
from agile_jax.robot import RobotState

# All of these must be kept; once the robot stands, it steps again only at twice as much.
BODY_SPEED = 0.15  # of the centre of mass in the plane [m/s]
REFERENCE_YAW_RATE = 0.1  # [rad/s]
DISTANCE, YAW_ERROR = 0.03, 0.05  # between trunk and reference [m], [rad]
LEAN, TWIST = 0.02, 0.05  # between the trunk and its feet: shift [m], turn [rad]


def at_rest(
    standing: Bool[Array, ""],
    body: Body,
    robot_state: RobotState,
    feet_world: Float[Array, "4 3"],
    nominal_feet: Float[AnyArray, "4 2"],
    reference: Reference,
    stand_speed: float,
) -> Bool[Array, ""]:
    """Whether nothing asks for a step, neither the reference nor how far the trunk has left its feet.

    Args:
        standing: whether the robot stands already.
        body, robot_state: measured.
        feet_world: where the feet are [m].
        nominal_feet: where they are under a robot that stands, in the plane of its trunk [m].
        reference: of the trunk.
        stand_speed: of the reference, below which the robot stands [m/s].
    """
    patience = jnp.where(standing, 2.0, 1.0)
    speeds = planar_speed(reference)
    distance = jnp.sqrt(jnp.sum((reference.pose[:2] - robot_state.base_pos[:2]) ** 2))
    turn = jnp.abs(wrap_angle(reference.pose[3] - body.rpy[2], jnp))
    shift = (feet_world - robot_state.base_pos)[:, :2] @ body.R_world_yaw[:2, :2] - nominal_feet
    lean = jnp.sqrt(jnp.sum(shift.mean(0) ** 2))
    moment = jnp.abs(jnp.sum(nominal_feet[:, 0] * shift[:, 1] - nominal_feet[:, 1] * shift[:, 0]))
    return (
        (speeds.max() < patience * stand_speed)
        & (jnp.abs(reference.velocities[:, 3]).max() < patience * REFERENCE_YAW_RATE)
        & (distance < patience * DISTANCE)
        & (turn < patience * YAW_ERROR)
        & (lean < patience * LEAN)
        & (moment / jnp.sum(nominal_feet**2) < patience * TWIST)
        & (jnp.sqrt(jnp.sum(body.com_velocity_world[:2] ** 2)) < patience * BODY_SPEED)
    )


def planar_speed(reference: Reference) -> jax.Array:
    """Speed of the reference in the plane at the nodes of the horizon, shape (N,) [m/s]."""
    return jnp.sqrt(jnp.sum(reference.velocities[:, :2] ** 2, -1))
