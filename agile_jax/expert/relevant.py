"""The obstacles that matter for one start: those that the path would otherwise meet.

The number of regions grows with six to the power of the number of obstacles, yet a path has to do with few of them. So
a start is solved among some of the obstacles, at first among none. Leaving obstacles out only enlarges the free space:
when the best path clears those that were left out as well, it is the best among all, and when there is none, there is
none among all. Otherwise what it meets first is added, and the start is solved again.
"""

import numpy as np

from agile_jax.expert.solution import Trajectory
from agile_jax.expert.verify import dense_poses
from agile_jax.scene import Scene, obstacle_clearances

FEW = 2  # obstacles, of which those in the way are taken at once: they are nearly always met


def first_obstacles(scene: Scene, start: np.ndarray, margin: float) -> np.ndarray:
    """Which obstacles to begin with: of few those that, grown by torso and margin, reach into the box around start and
    target; else none. Shape (n,), bool."""
    if len(scene.obstacle_centers) > FEW:
        return np.zeros(len(scene.obstacle_centers), bool)
    low, high = np.minimum(start, scene.target)[:3], np.maximum(start, scene.target)[:3]
    torso = np.array([*[np.hypot(*scene.torso_half_size[:2])] * 2, scene.torso_half_size[2]])
    half = scene.obstacle_half_sizes.copy()
    half[:, :2] = np.hypot(half[:, 0], half[:, 1])[:, None]  # at any yaw
    reach = half + torso + margin
    return np.asarray(((scene.obstacle_centers + reach > low) & (scene.obstacle_centers - reach < high)).all(1))


def with_obstacles(scene: Scene, chosen: np.ndarray) -> Scene:
    """The scene with some of its obstacles, shape (n,), bool."""
    fields = {name: getattr(scene, name)[chosen] for name in scene._fields if name.startswith("obstacle_")}
    return scene._replace(**fields)


def obstacles_met(scene: Scene, chosen: np.ndarray, trajectory: Trajectory, margin: float, scheme: str) -> np.ndarray:
    """Which of the obstacles that are not chosen a trajectory is the first to come nearer to than the margin, if any;
    shape (n,), bool."""
    met = np.zeros(len(chosen), bool)
    others = np.flatnonzero(~chosen)
    poses = dense_poses(trajectory, scheme=scheme)
    near = obstacle_clearances(with_obstacles(scene, ~chosen), poses) < margin
    if near.any():
        first = np.where(near.any(0), near.argmax(0), len(poses))
        met[others[int(np.argmin(first))]] = True
    return met
