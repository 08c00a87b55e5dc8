"""Limits of the field's output: the bounds on the velocity, and braking before obstacles."""

import jax
import jax.numpy as jnp

from agile_jax.policy.features import YAW
from agile_jax.scene import Scene, obstacle_clearances, turns_freely, yaw_between_bounds


def within_limits(velocity: jax.Array, velocity_limit: jax.Array) -> jax.Array:
    """The velocity scaled so that every axis is within its bound; its direction is kept. Shape (4,)."""
    return velocity / jnp.maximum(jnp.abs(velocity / velocity_limit).max(-1, keepdims=True), 1.0)


def brake_before_obstacles(
    scene: Scene, pose: jax.Array, velocity: jax.Array, acceleration_limit: jax.Array, margin: float
) -> jax.Array:
    """Take from the velocity what closes on an obstacle faster than could still be braked before the margin.

    With clearance d, its gradient g in the pose, its part g_p in the position (a unit vector) and W = diag(A^2), the
    position's axes braking together along W g_p decelerate d by a = sqrt(g_p W g_p). So the approach -g . v may be at
    most sqrt(2 a (d - margin)); the excess is removed along W g_p, the smallest change in units of the accelerations.
    Motion along the obstacle and away from it is untouched. The yaw counts in the approach but is not used to brake:
    turning away would leave the speed for later.

    Args:
        scene: of n boxes, taken one after the other.
        pose, velocity, acceleration_limit: shape (4,).
        margin: [m].
    """
    if len(scene.obstacle_centers) == 0:
        return velocity
    distances = obstacle_clearances(scene, pose, jnp)  # (n,)
    gradients = jax.jacrev(lambda s: obstacle_clearances(scene, s, jnp))(pose)  # (n, 4)
    weights = (acceleration_limit**2).at[YAW].set(0.0)
    for i in range(len(scene.obstacle_centers)):
        weighted = weights * gradients[i]
        square = jnp.maximum(gradients[i] @ weighted, 1e-9)
        allowed = jnp.sqrt(2.0 * jnp.sqrt(square) * jnp.maximum(distances[i] - margin, 0.0))
        excess = jnp.maximum(-(gradients[i] @ velocity) - allowed, 0.0)
        velocity = velocity + excess * weighted / square
    return velocity


def brake_before_bounds(scene: Scene, pose: jax.Array, velocity: jax.Array, acceleration_limit: jax.Array) -> jax.Array:
    """Cut each axis's velocity to what can still be braked before the bounds of the pose. Shape (4,).

    The bounds are walls as the obstacles are: below the lowest height a crouching leg has no room left. Bounds of yaw
    that hold a full circle are none (scene/heading.py).
    """
    pose = pose.at[YAW].set(yaw_between_bounds(scene, pose[YAW], jnp))
    up = jnp.sqrt(2.0 * acceleration_limit * jnp.maximum(jnp.asarray(scene.upper) - pose, 0.0))
    down = jnp.sqrt(2.0 * acceleration_limit * jnp.maximum(pose - jnp.asarray(scene.lower), 0.0))
    limited = jnp.clip(velocity, -down, up)
    return limited.at[YAW].set(velocity[YAW]) if turns_freely(scene) else limited
