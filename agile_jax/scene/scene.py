"""The scene as arrays, and the exact clearance of the torso in it."""

from collections.abc import Sequence
from types import ModuleType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from agile_jax.arrays import AnyArray
from agile_jax.geometry import prism_distance, rectangle_distance
from agile_jax.scene.settings import POSE_NAMES, SceneSettings

POSE_SIZE = len(POSE_NAMES)
PoseLike = Sequence[float | int] | np.ndarray  # x y z yaw [m, m, m, rad]
# The outward faces of an upright box, by where the obstacle lies for who passes: name, axis, sign of the normal.
HEADROOM = 0.1  # that obstacles without a way over keep above the highest torso, more than any margin [m]
BOX_FACES = (("left", 1, +1), ("right", 1, -1), ("front", 0, -1), ("back", 0, +1), ("under", 2, -1), ("over", 2, +1))
FLAT = 1e-4  # [m] half the room that a fixed height leaves a solver


class Scene(NamedTuple):
    """Obstacles are made of n boxes turned about the vertical.

    The boxes of one obstacle follow one another and have one yaw; the first one holds the outline of the others in
    the plane: a table's slab, then its legs.
    """

    obstacle_centers: Float[np.ndarray, "n 3"]  # [m]
    obstacle_half_sizes: Float[np.ndarray, "n 3"]  # [m]
    obstacle_yaws: Float[np.ndarray, " n"]  # [rad]
    obstacle_numbers: Int[np.ndarray, " n"]  # the obstacle, in the order of the settings, that a box belongs to
    target: Float[np.ndarray, "4"]  # pose [m, rad]
    torso_half_size: Float[np.ndarray, "3"]  # along the torso's own axes [m]
    lower: Float[np.ndarray, "4"]  # bounds of the pose [m, rad]
    upper: Float[np.ndarray, "4"]
    speed_heights: Float[np.ndarray, " k"] = np.empty(0)  # increasing [m]; none where no height limits the speed
    speed_limits: Float[np.ndarray, " k"] = np.empty(0)  # top speed at these, convex (crouch.py) [m/s]


def make_scene(settings: SceneSettings) -> Scene:
    """The scene that `settings` describe, in float64."""
    x, y, z, yaw = settings.lower
    crouch = settings.crouch
    boxes = [obstacle.boxes() for obstacle in settings.obstacles]
    yaws = [obstacle.yaw for obstacle, parts in zip(settings.obstacles, boxes, strict=True) for _ in parts]
    return Scene(
        obstacle_centers=np.array([center for parts in boxes for center, _ in parts], float).reshape(-1, 3),
        obstacle_half_sizes=np.array([half for parts in boxes for _, half in parts], float).reshape(-1, 3),
        obstacle_yaws=np.array(yaws, float),
        obstacle_numbers=np.array([number for number, parts in enumerate(boxes) for _ in parts], int),
        target=np.array(settings.target),
        torso_half_size=np.array(settings.torso_half_size),
        lower=np.array([x, y, z or crouch.lowest, yaw]),
        upper=np.array(settings.upper),
        speed_heights=np.array(crouch.heights, float),
        speed_limits=np.array(crouch.speeds, float),
    )


def obstacle_boxes(scene: Scene) -> list[list[int]]:
    """The numbers of the boxes that each obstacle is made of, the outermost one first."""
    found: dict[int, list[int]] = {}
    for box, number in enumerate(scene.obstacle_numbers.tolist()):
        found.setdefault(number, []).append(box)
    return list(found.values())


def obstacle_clearances(
    scene: Scene, pose: Float[AnyArray, "*batch 4"], xp: ModuleType = np
) -> Float[AnyArray, "*batch n"]:
    """Exact signed distance of the torso's box, turned by its yaw, to each of the obstacles' boxes [m].

    Positive: Euclidean distance. Negative: minus the penetration depth. The torso's box reaches down to the floor, on
    which its legs stand: a pose over an obstacle is not clear of it, however high.

    Args:
        scene: a scene of n boxes.
        pose: poses [x, y, z, yaw] of the torso [m, rad].
        xp: numpy or jax.numpy.
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
    below = scene.obstacle_centers[:, 2] - pose[..., 2]
    vertical = below - scene.obstacle_half_sizes[:, 2] - scene.torso_half_size[2]
    return prism_distance(planar, vertical, xp)


def clearance(scene: Scene, pose: Float[AnyArray, "*batch 4"], xp: ModuleType = np) -> Float[AnyArray, "*batch"]:
    """Exact signed distance of the torso's box to the nearest obstacle [m]; infinity in an empty scene."""
    if len(scene.obstacle_centers) == 0:
        return xp.full(pose.shape[:-1], xp.inf)
    return obstacle_clearances(scene, pose, xp).min(-1)


def without_way_over(scene: Scene) -> Scene:
    """The scene whose obstacles reach so high that none can be passed over: the robot's legs stand on the floor."""
    reach = scene.upper[2] + scene.torso_half_size[2]
    bottoms = scene.obstacle_centers[:, 2] - scene.obstacle_half_sizes[:, 2]
    tops = scene.obstacle_centers[:, 2] + scene.obstacle_half_sizes[:, 2]
    low = tops < reach + HEADROOM
    if not low.any():
        return scene
    tops = np.where(low, np.maximum(reach, bottoms) + 2 * HEADROOM, tops)
    centers, halves = scene.obstacle_centers.copy(), scene.obstacle_half_sizes.copy()
    centers[low, 2], halves[low, 2] = ((tops + bottoms) / 2)[low], ((tops - bottoms) / 2)[low]
    return scene._replace(obstacle_centers=centers, obstacle_half_sizes=halves)


def planar_scene(scene: Scene) -> Scene:
    """The scene of plans in the plane only (the paper's figure 2).

    The height is the target's, and every obstacle stands on the floor, so that no path leads under it.
    """
    tops = scene.obstacle_centers[:, 2] + scene.obstacle_half_sizes[:, 2]
    centers, halves = scene.obstacle_centers.copy(), scene.obstacle_half_sizes.copy()
    centers[:, 2] = halves[:, 2] = tops / 2
    lower, upper = scene.lower.copy(), scene.upper.copy()
    lower[2], upper[2] = scene.target[2] - FLAT, scene.target[2] + FLAT
    return scene._replace(obstacle_centers=centers, obstacle_half_sizes=halves, lower=lower, upper=upper)
