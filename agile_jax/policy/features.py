"""Inputs of the residual field: where the target is, and where the walls are.

The position relative to the target alone leaves the network to find out where a table begins, from samples of which
few are near its edges. The signed distances of the torso to the planes of every face say it directly, and
tanh(distance / length) makes them matter only nearby.
"""

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.scene import POSE_NAMES, Scene, obstacle_clearances, pose_error

YAW = POSE_NAMES.index("yaw")


def face_distances(scene: Scene, pose: jax.Array) -> jax.Array:
    """Signed distances of the torso's box to the planes of the six faces of each of the obstacles' boxes [m].

    Positive: the whole torso is on the outer side. A box is touched exactly where, without a turn between
    torso and box, all its six are negative.

    Args:
        scene: of n boxes.
        pose: shape (4,) [m, rad].

    Returns:
        Shape (n, 6): along the box's own +x, -x, +y, -y, +z, -z.
    """
    yaw = pose[YAW] - scene.obstacle_yaws  # (n,)
    c, s = jnp.abs(jnp.cos(yaw)), jnp.abs(jnp.sin(yaw))
    half = scene.torso_half_size
    reach = jnp.stack([c * half[0] + s * half[1], s * half[0] + c * half[1], jnp.full_like(c, half[2])], -1)  # (n, 3)
    offset = pose[:3] - scene.obstacle_centers
    cos, sin = np.cos(scene.obstacle_yaws), np.sin(scene.obstacle_yaws)
    local = jnp.stack(
        [cos * offset[:, 0] + sin * offset[:, 1], -sin * offset[:, 0] + cos * offset[:, 1], offset[:, 2]], -1
    )
    inflated = scene.obstacle_half_sizes + reach
    return jnp.stack([local - inflated, -local - inflated], -1).reshape(-1, 6)


def wall_features(scene: Scene, pose: jax.Array, length: float) -> jax.Array:
    """tanh(distance / length) of the six faces and of the exact clearance of each box. Shape (7 n,)."""
    distances = jnp.concatenate([face_distances(scene, pose), obstacle_clearances(scene, pose, jnp)[:, None]], -1)
    return jnp.tanh(distances / length).reshape(-1)


def features(scene: Scene, pose: jax.Array, wall_length: float | None) -> jax.Array:
    """The error to the target, and the wall features when `wall_length` [m] is given. Shape (4,) or (4 + 7 n,)."""
    error = pose_error(scene, pose, jnp)
    if wall_length is None or len(scene.obstacle_centers) == 0:
        return error
    return jnp.concatenate([error, wall_features(scene, pose, wall_length)])


def natural_range(scene: Scene, count: int) -> np.ndarray:
    """Half of what each of the `count` inputs can span, shape (count,): the pose's bounds, then 1 for each tanh."""
    return np.concatenate([(scene.upper - scene.lower) / 2, np.ones(count - len(scene.target))])
