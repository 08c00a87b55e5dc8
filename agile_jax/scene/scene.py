"""The scene as arrays, and the exact clearance of the torso in it."""

from typing import Any, NamedTuple

import numpy as np

from agile_jax.geometry import Array, prism_distance, rectangle_distance
from agile_jax.scene.settings import SceneSettings, TableSettings

POSE_NAMES = ("x", "y", "z", "yaw")  # the planned pose s [m, m, m, rad]
POSE_SIZE = len(POSE_NAMES)
FLAT = 1e-4  # [m] half the room that a fixed height leaves a solver


class Scene(NamedTuple):
    """Obstacles are boxes turned about the vertical. All lengths in [m], angles in [rad]."""

    obstacle_centers: np.ndarray  # (n, 3)
    obstacle_half_sizes: np.ndarray  # (n, 3)
    obstacle_yaws: np.ndarray  # (n,)
    target: np.ndarray  # (4,) pose
    torso_half_size: np.ndarray  # (3,) along the torso's own axes
    lower: np.ndarray  # (4,) bounds of the pose
    upper: np.ndarray  # (4,)


def make_scene(settings: SceneSettings) -> Scene:
    """The scene that `settings` describe, in float64."""
    centers, halves, yaws = [], [], []
    for obstacle in settings.obstacles:
        if isinstance(obstacle, TableSettings):
            low, high = obstacle.underside, obstacle.top
            centers.append([*obstacle.position, (low + high) / 2])
            halves.append([obstacle.size[0] / 2, obstacle.size[1] / 2, (high - low) / 2])
        else:
            centers.append(list(obstacle.position))
            halves.append([size / 2 for size in obstacle.size])
        yaws.append(obstacle.yaw)
    return Scene(
        obstacle_centers=np.array(centers, float).reshape(-1, 3),
        obstacle_half_sizes=np.array(halves, float).reshape(-1, 3),
        obstacle_yaws=np.array(yaws, float),
        target=np.array(settings.target),
        torso_half_size=np.array(settings.torso_half_size),
        lower=np.array(settings.lower),
        upper=np.array(settings.upper),
    )


def obstacle_clearances(scene: Scene, pose: Array, xp: Any = np) -> Array:
    """Exact signed distance of the torso's box, turned by its yaw, to each obstacle [m].

    Positive: Euclidean distance. Negative: minus the penetration depth.

    Args:
        scene: n obstacles.
        pose: [x, y, z, yaw], shape (..., 4) [m, rad].
        xp: numpy or jax.numpy.

    Returns:
        Shape (..., n).
    """
    pose = pose[..., None, :]
    planar = rectangle_distance(
        pose[..., :2],
        xp.asarray(scene.torso_half_size[:2]),
        pose[..., 3],
        xp.asarray(scene.obstacle_centers[:, :2]),
        xp.asarray(scene.obstacle_half_sizes[:, :2]),
        xp.asarray(scene.obstacle_yaws),
        xp,
    )
    vertical = (
        xp.abs(pose[..., 2] - scene.obstacle_centers[:, 2]) - scene.obstacle_half_sizes[:, 2] - scene.torso_half_size[2]
    )
    return prism_distance(planar, vertical, xp)


def clearance(scene: Scene, pose: Array, xp: Any = np) -> Array:
    """Exact signed distance of the torso's box to the nearest obstacle [m]; infinity in an empty scene. Shape (...)."""
    if len(scene.obstacle_centers) == 0:
        return xp.full(pose.shape[:-1], xp.inf)
    return obstacle_clearances(scene, pose, xp).min(-1)


def planar_scene(scene: Scene) -> Scene:
    """The scene of a planner that knows the plane only (the paper's figure 2): the height is the target's, every
    obstacle stands on the floor, so that no path leads under it."""
    tops = scene.obstacle_centers[:, 2] + scene.obstacle_half_sizes[:, 2]
    centers, halves = scene.obstacle_centers.copy(), scene.obstacle_half_sizes.copy()
    centers[:, 2] = halves[:, 2] = tops / 2
    lower, upper = scene.lower.copy(), scene.upper.copy()
    lower[2], upper[2] = scene.target[2] - FLAT, scene.target[2] + FLAT
    return scene._replace(obstacle_centers=centers, obstacle_half_sizes=halves, lower=lower, upper=upper)
