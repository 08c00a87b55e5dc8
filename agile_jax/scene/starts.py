"""The start distribution, with what it rejects counted."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.scene.scene import POSE_SIZE, Scene, clearance
from agile_jax.settings import BadInput


class Starts(NamedTuple):
    """Accepted start poses and the account of the draws that were not."""

    poses: Float[np.ndarray, "n 4"]  # [m, rad]
    attempted: int
    rejected_collision: int  # closer to an obstacle than the margin
    rejected_bounds: int  # outside the bounds of the pose


def sample_starts(
    scene: Scene,
    mean: Float[np.ndarray, "4"],
    std: Float[np.ndarray, "4"],
    count: int,
    margin: float,
    key: tuple[int, ...],
) -> Starts:
    """Draw `count` start poses from a normal distribution, rejecting those in collision or out of bounds.

    Draw i is a pure function of (key, i), so that a longer list begins with the shorter one.

    Args:
        scene: obstacles and bounds.
        mean, std: mean and standard deviations of the pose [m, rad].
        count: how many poses to accept.
        margin: least clearance of the torso [m].
        key: entropy of the generator, for example (seed, purpose).

    Raises:
        BadInput: hardly any start is free.
    """
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))
    poses = np.empty((0, POSE_SIZE))
    attempted = collisions = out_of_bounds = 0
    while len(poses) < count:
        draws = mean + std * generator.standard_normal((256, POSE_SIZE))
        outside = np.asarray(((draws < scene.lower) | (draws > scene.upper)).any(-1))
        hit = ~outside & np.asarray(clearance(scene, draws) < margin)
        free = ~outside & ~hit
        last = 256
        if free.sum() >= count - len(poses):  # count only the draws up to the last that is needed
            last = int(np.flatnonzero(free)[count - len(poses) - 1]) + 1
        poses = np.concatenate([poses, draws[:last][free[:last]]])
        attempted += last
        collisions += int(hit[:last].sum())
        out_of_bounds += int(outside[:last].sum())
        if attempted > 10_000 and len(poses) < 0.001 * attempted:
            raise BadInput(
                f"scene.start: {len(poses)} of {attempted} starts are free (mean {mean.tolist()}, std {std.tolist()}, "
                f"margin {margin:g} m): {collisions} are nearer to an obstacle than the margin, {out_of_bounds} out of "
                "bounds; widen the bounds or move the starts away from the obstacles"
            )
    return Starts(poses, attempted, collisions, out_of_bounds)
