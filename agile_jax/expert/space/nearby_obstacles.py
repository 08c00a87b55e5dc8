"""The obstacles that matter for one start: those that the path would otherwise meet.

The number of regions grows with six to the power of the number of obstacles, yet a path has to do with few of them. So
a start is solved among some of the obstacles, at first among none. Leaving obstacles out only enlarges the free space:
when the best path clears those that were left out as well, it is the best among all, and when there is none, there is
none among all. Otherwise what it meets first is added, and the start is solved again. Before a path is left to the
general program, which takes long, the straight lines along its route are tried in its place.

An obstacle is one of the settings: the slab and the legs of a table are taken together, and all arrays are per box.
"""

import itertools

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.scene import Scene, obstacle_clearances

LINE_POSES = 40  # poses on a straight line
FEW_OBSTACLES = 2  # obstacles, of which those in the way are taken at once: they are nearly always met


def first_obstacles(problem: Problem, margin: float) -> np.ndarray:
    """Which obstacles to begin with: of few those that, grown by torso and margin, reach into the rectangle around
    start and target; else none. Shape (n,), bool."""
    scene, start = problem.scene, problem.start
    numbers = scene.obstacle_numbers.tolist()
    if len(set(numbers)) > FEW_OBSTACLES:
        return np.zeros(len(numbers), bool)
    low, high = np.minimum(start, scene.target)[:2], np.maximum(start, scene.target)[:2]
    radius = np.hypot(*scene.obstacle_half_sizes[:, :2].T) + np.hypot(*scene.torso_half_size[:2])  # at any yaw
    reach, centers = (radius + margin)[:, None], scene.obstacle_centers[:, :2]
    within = ((centers + reach > low) & (centers - reach < high)).all(1)
    met = {number for number, is_within in zip(numbers, within.tolist(), strict=True) if is_within}
    return np.array([number in met for number in numbers], bool)


def with_obstacles(scene: Scene, chosen: np.ndarray) -> Scene:
    """The scene with some of its boxes, shape (n,), bool."""
    fields = {name: getattr(scene, name)[chosen] for name in scene._fields if name.startswith("obstacle_")}
    return scene._replace(**fields)


def straight_path(points: np.ndarray) -> np.ndarray:
    """Poses on the straight lines between points, shape (p, 4)."""
    shares = np.linspace(0, 1, LINE_POSES, endpoint=False)[:, None]
    lines = [a + shares * (b - a) for a, b in itertools.pairwise(points)]
    return np.concatenate([*lines, points[-1:]])


def first_met(scene: Scene, poses: np.ndarray, margin: float) -> int | None:
    """The number (`Scene.obstacle_numbers`) of the obstacle that a path through poses, shape (m, 4), is the first to
    come nearer to than the margin."""
    close = obstacle_clearances(scene, poses) < margin  # (m, n)
    if not close.any():
        return None
    return int(scene.obstacle_numbers[np.argmin(np.where(close.any(0), close.argmax(0), len(poses)))])
