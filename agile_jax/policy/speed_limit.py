"""Limits of the field's output: the bounds on the velocity, and braking before obstacles."""

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.scene import Scene, obstacle_clearances


def within_limits(velocity: jax.Array, velocity_limit: jax.Array) -> jax.Array:
    """The velocity scaled so that every axis is within its bound; its direction is kept. Shape (4,)."""
    return velocity / jnp.maximum(jnp.abs(velocity / velocity_limit).max(-1, keepdims=True), 1.0)


def brake_before_obstacles(
    scene: Scene, pose: jax.Array, velocity: jax.Array, acceleration_limit: jax.Array, margin: float
) -> jax.Array:
    """Take from the velocity what closes on an obstacle faster than could still be braked before the margin.

    With clearance d, its gradient g in the pose and W = diag(A^2), the axes braking together along W g decelerate d
    by a = sqrt(g W g). So the approach -g . v may be at most sqrt(2 a (d - margin)); the excess is removed along
    W g, the smallest change in units of the accelerations. Motion along the obstacle and away from it is untouched.

    Args:
        scene: n obstacles, taken one after the other.
        pose, velocity, acceleration_limit: shape (4,).
        margin: [m].
    """
    if len(scene.obstacle_centers) == 0:
        return velocity
    distances = obstacle_clearances(scene, pose, jnp)  # (n,)
    gradients = jax.jacrev(lambda s: obstacle_clearances(scene, s, jnp))(pose)  # (n, 4)
    weights = acceleration_limit**2
    for i in range(len(np.asarray(scene.obstacle_centers))):
        g = gradients[i]
        weighted = weights * g
        square = jnp.maximum(g @ weighted, 1e-9)
        brake = jnp.sqrt(square)  # deceleration along g of the axes braking together in the direction W g
        allowed = jnp.sqrt(2.0 * brake * jnp.maximum(distances[i] - margin, 0.0))
        excess = jnp.maximum(-(g @ velocity) - allowed, 0.0)
        velocity = velocity + excess * weighted / square
    return velocity
