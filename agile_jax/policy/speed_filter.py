"""Limits of the field's output: the bounds on the velocity, and braking before obstacles."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.policy.separating_planes import FACES, YAW, separating_planes
from agile_jax.scene import Scene, turns_freely, yaw_between_bounds

# Pairs of adjacent faces of an obstacle: opposite ones share no edge.
EDGES = np.array([(f, g) for f in range(FACES) for g in range(FACES) if f // 2 != g // 2]).T


def within_limits(velocity: Float[Array, "4"], velocity_limit: Float[AnyArray, "4"]) -> Float[Array, "4"]:
    """The velocity [m/s, rad/s] scaled so that every axis is within its bound; its direction is kept."""
    return velocity / jnp.maximum(jnp.abs(velocity / velocity_limit).max(-1, keepdims=True), 1.0)


def brake_before_obstacles(
    scene: Scene,
    pose: Float[Array, "4"],
    velocity: Float[Array, "4"],
    acceleration_limit: Float[AnyArray, "4"],
    margin: float,
) -> Float[Array, "4"]:
    """Take from the velocity what would bring the torso nearer to an obstacle than the margin.

    For one obstacle let d_f be the signed distances along the ten directions that can part it from the torso
    (separating_planes.py), J_f their gradients in the pose, and W = diag(A^2). The torso is clear while one d_f is
    positive, so a velocity is safe when any of these holds:

        plane f, d_f > 0:           -J_f . v <= sqrt(2 a_f (d_f - m)): it can be braked before the plane of f,
                                    a_f = sqrt(J_f W J_f) what the axes brake together
        edge f g, d_f > m > d_g:    ((d_f - m) J_g + (m - d_g) J_f) . v >= 0: straight on, it is outside face g before
                                    it meets face f, like the torso that ducks while it runs towards a table

    Each is a half-space of velocities; the velocity is moved into the nearest one, along W J, the smallest change in
    units of the accelerations. A velocity that is in one of them, as along the labels, is untouched. A turn counts
    where it approaches only, and is not used to brake: what it gives ends with it, and leaves the speed for later. The
    torso's own sides count where the obstacle's faces leave no room. A torso that touches is led out by the plane that
    parts it soonest.

    Args:
        scene: of n boxes, taken one after the other.
        pose: [m, rad].
        velocity: wanted at it [m/s, rad/s].
        acceleration_limit: A [m/s^2, rad/s^2].
        margin: m [m].
    """
    wx, wy, wz, _ = acceleration_limit**2
    on, off = EDGES
    for i in range(len(scene.obstacle_centers)):
        planes = separating_planes(scene, pose, i)
        distance = planes.distance
        room, beyond = jnp.maximum(distance - margin, 0.0), jnp.maximum(margin - distance, 0.0)
        x, y, z, yaw = (jnp.concatenate([part, room[on] * part[off] + beyond[off] * part[on]]) for part in planes[1:])
        square = wx * x**2 + wy * y**2 + wz * z**2
        allowed = jnp.sqrt(2.0 * jnp.sqrt(square[: len(distance)]) * room)
        allowed = jnp.concatenate([allowed, jnp.zeros(len(on), allowed.dtype)])
        sides = (jnp.arange(len(distance)) < FACES) | (distance[:FACES].max() < margin)
        holds = ((distance > 0.0) & sides) | (distance >= distance.max())
        holds = jnp.concatenate([holds, (room[on] > 0.0) & (beyond[off] > 0.0)])
        turning = jnp.maximum(-yaw * velocity[3], 0.0)  # what a turn takes; what it gives ends with the turn
        approach = turning - (x * velocity[0] + y * velocity[1] + z * velocity[2])
        excess = jnp.maximum(approach - allowed, 0.0)
        change = excess / jnp.maximum(square, 1e-9)
        nearest = jnp.argmin(jnp.where(holds, excess * change, jnp.inf))
        change = jnp.where(jnp.arange(len(change)) == nearest, change, 0.0)
        velocity += jnp.stack([wx * (change * x).sum(), wy * (change * y).sum(), wz * (change * z).sum(), 0.0 * wx])
    return velocity


def brake_before_bounds(
    scene: Scene, pose: Float[Array, "4"], velocity: Float[Array, "4"], acceleration_limit: Float[AnyArray, "4"]
) -> Float[Array, "4"]:
    """Cut each axis's velocity [m/s, rad/s] to what can still be braked before the bounds of the pose [m, rad].

    The bounds are walls as the obstacles are: below the lowest height a crouching leg has no room left. If the bounds
    of yaw span a full turn, yaw is unbounded (scene/heading.py).
    """
    pose = pose.at[YAW].set(yaw_between_bounds(scene, pose[YAW], jnp))
    up = jnp.sqrt(2.0 * acceleration_limit * jnp.maximum(jnp.asarray(scene.upper) - pose, 0.0))
    down = jnp.sqrt(2.0 * acceleration_limit * jnp.maximum(pose - jnp.asarray(scene.lower), 0.0))
    limited = jnp.clip(velocity, -down, up)
    return limited.at[YAW].set(velocity[YAW]) if turns_freely(scene) else limited
