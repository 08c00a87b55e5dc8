"""Which positions are under an obstacle, and how high a torso may be there. Loads neither JAX nor Matplotlib."""

import numpy as np
from jaxtyping import Float

from agile_jax.geometry import rotation_2d
from agile_jax.scene import Scene


def underside_above(scene: Scene, position: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, " K"]:
    """The underside [m] of the lowest obstacle above each position [m]; NaN where nothing is above."""
    underside = np.full(len(position), np.inf)
    for center, half, yaw in zip(scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True):
        local = (position[:, :2] - center[:2]) @ rotation_2d(np.asarray(yaw))
        inside = (np.abs(local) <= half[:2]).all(-1) & (position[:, 2] <= center[2] - half[2])
        underside = np.where(inside, np.minimum(underside, center[2] - half[2]), underside)
    return np.where(np.isfinite(underside), underside, np.nan)


def went_under(scene: Scene, position: Float[np.ndarray, "K 3"]) -> bool:
    """Whether one of the positions [m] is under an obstacle."""
    return bool(np.isfinite(underside_above(scene, position)).any())


def crawl_height(scene: Scene, margin: float) -> float | None:
    """Greatest height [m] of the torso's centre under the lowest obstacle that it can pass under, with a margin [m].

    None where it can pass under no obstacle.
    """
    undersides = scene.obstacle_centers[:, 2] - scene.obstacle_half_sizes[:, 2]
    heights = undersides - scene.torso_half_size[2] - margin
    passable = heights[heights > scene.lower[2]]
    return float(passable.min()) if len(passable) else None
