"""Limits of the field's output: the bounds on the velocity, and braking before obstacles."""

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.features import YAW, face_distances
from agile_jax.scene import Scene, obstacle_clearances

# Pairs of adjacent faces, of the six in the order of `face_distances`: opposite ones share no edge.
EDGES = np.array([(f, g) for f in range(6) for g in range(6) if f // 2 != g // 2]).T


def within_limits(velocity: jax.Array, velocity_limit: jax.Array) -> jax.Array:
    """The velocity scaled so that every axis is within its bound; its direction is kept. Shape (4,)."""
    return velocity / jnp.maximum(jnp.abs(velocity / velocity_limit).max(-1, keepdims=True), 1.0)


def brake_before_obstacles(
    scene: Scene, pose: jax.Array, velocity: jax.Array, acceleration_limit: jax.Array, margin: float
) -> jax.Array:
    """Take from the velocity what would bring the torso nearer to an obstacle than the margin.

    For one obstacle let d_f be the signed distances to the planes of its faces, J_f their gradients in the pose, and
    W = diag(A^2). The torso is clear while one d_f is positive, so a velocity is safe when any of these holds:

        face f, d_f > 0:            -J_f . v <= sqrt(2 a_f (d_f - m)): it can be braked before the plane of f,
                                    a_f = sqrt(J_f W J_f) what the axes brake together
        edge f g, d_f > m > d_g:    ((d_f - m) J_g + (m - d_g) J_f) . v >= 0: straight on, it is outside g before it
                                    meets f, like the torso that ducks while it runs towards a table
        clearance d, gradient J:    -J . v <= sqrt(2 a (d - m)): exact for a torso that is turned against the obstacle,
                                    of which the faces see its bounding box only

    Each is a half-space of velocities; the velocity is moved into the nearest one, along W J, the smallest change in
    units of the accelerations. A velocity that is in one of them, as along the labels, is untouched. The yaw counts in
    the approach but is not used to brake: turning away would leave the speed for later.

    Args:
        scene: n obstacles, taken one after the other.
        pose, velocity, acceleration_limit: shape (4,).
        margin: m [m].
    """
    if len(scene.obstacle_centers) == 0:
        return velocity
    weights = (acceleration_limit**2).at[YAW].set(0.0)
    faces = face_distances(scene, pose)  # (n, 6)
    face_normals = jax.jacfwd(lambda s: face_distances(scene, s))(pose)  # (n, 6, 4)
    exact = obstacle_clearances(scene, pose, jnp)  # (n,)
    exact_normals = jax.jacrev(lambda s: obstacle_clearances(scene, s, jnp))(pose)  # (n, 4)
    for i in range(len(exact)):
        spaces = _safe_half_spaces(faces[i], face_normals[i], exact[i], exact_normals[i], weights, margin)
        velocity = _into_nearest(velocity, *spaces, weights)
    return velocity


def _safe_half_spaces(
    faces: jax.Array,
    face_normals: jax.Array,
    exact: jax.Array,
    exact_normal: jax.Array,
    weights: jax.Array,
    margin: float,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Of one obstacle the half-spaces -normal . v <= allowed: normals (k, 4), allowed (k,), whether they hold (k,)."""
    on, off = EDGES
    distances, normals = jnp.append(faces, exact), jnp.concatenate([face_normals, exact_normal[None]])  # (7,), (7, 4)
    room = jnp.maximum(distances - margin, 0.0)
    braking = jnp.sqrt(jnp.maximum((normals**2 * weights).sum(-1), 0.0))
    allowed = jnp.sqrt(2.0 * braking * room)
    valid = (distances > 0.0).at[-1].set(True)
    beyond = jnp.maximum(margin - faces, 0.0)
    edges = room[on, None] * face_normals[off] + beyond[off, None] * face_normals[on]
    return (
        jnp.concatenate([normals, edges]),
        jnp.concatenate([allowed, jnp.zeros(len(on))]),
        jnp.concatenate([valid, (room[on] > 0.0) & (beyond[off] > 0.0)]),
    )


def _into_nearest(
    velocity: jax.Array, normals: jax.Array, allowed: jax.Array, valid: jax.Array, weights: jax.Array
) -> jax.Array:
    """The velocity (4,) moved into the nearest of the half-spaces, nearest in the metric of 1 / weights."""
    square = jnp.maximum((normals**2 * weights).sum(-1), 1e-9)
    excess = jnp.maximum(-(normals @ velocity) - allowed, 0.0)
    nearest = jnp.argmin(jnp.where(valid, excess**2 / square, jnp.inf))
    return velocity + excess[nearest] / square[nearest] * weights * normals[nearest]


def brake_before_bounds(scene: Scene, pose: jax.Array, velocity: jax.Array, acceleration_limit: jax.Array) -> jax.Array:
    """Cut each axis's velocity to what can still be braked before the bounds of the pose. Shape (4,).

    The bounds are walls as the obstacles are: below the lowest height a crouching leg has no room left.
    """
    up = jnp.sqrt(2.0 * acceleration_limit * jnp.maximum(jnp.asarray(scene.upper) - pose, 0.0))
    down = jnp.sqrt(2.0 * acceleration_limit * jnp.maximum(pose - jnp.asarray(scene.lower), 0.0))
    return jnp.clip(velocity, -down, up)
