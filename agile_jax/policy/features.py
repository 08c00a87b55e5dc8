"""Inputs of the residual field: where the target is, and where the walls are.

The position relative to the target alone leaves the network to find out where a table begins, from samples of which
few are near its edges. The signed distances of the torso to the planes of every face say it directly, and
tanh(distance / length) makes them matter only nearby.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.policy.separating_planes import FACES, separating_planes
from agile_jax.scene import Scene, pose_error


def face_distances(scene: Scene, pose: Float[Array, "4"]) -> Float[Array, "n 6"]:
    """Signed distances of the torso's box to the planes of the six faces of each of the obstacles' boxes [m].

    Positive: the whole torso is on the outer side. A box is touched exactly where, without a turn between
    torso and box, all its six are negative.

    Args:
        scene: of n boxes.
        pose: [m, rad].

    Returns:
        Of each box, along the box's own +x, -x, +y, -y, +z, -z.
    """
    count = len(scene.obstacle_centers)
    return jnp.stack([separating_planes(scene, pose, i).distance[:FACES] for i in range(count)])


def wall_features(scene: Scene, pose: Float[Array, "4"], length: float) -> Float[Array, " walls"]:
    """tanh(distance / length) of the six faces of each box [-], at a pose [m, rad]; the length is in [m]."""
    return jnp.tanh(face_distances(scene, pose) / length).reshape(-1)


def features(scene: Scene, pose: Float[Array, "4"], wall_length: float | None) -> Float[Array, " f"]:
    """The error to the target [m, rad], and the wall features [-] when their length [m] is given, at a pose [m, rad].

    There are 4, or 4 + 6 n with n boxes.
    """
    error = pose_error(scene, pose, jnp)
    if wall_length is None or len(scene.obstacle_centers) == 0:
        return error
    return jnp.concatenate([error, wall_features(scene, pose, wall_length)])


def natural_range(scene: Scene, count: int) -> Float[np.ndarray, " {count}"]:
    """Half of what each of the `count` features can span: the pose's bounds [m, rad], then 1 for each other."""
    return np.concatenate([(scene.upper - scene.lower) / 2, np.ones(count - len(scene.target))])
