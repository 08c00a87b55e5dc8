"""Names of the ways past the obstacles. They are properties of the path alone, not of how it was found."""

import numpy as np

from agile_jax.geometry import support
from agile_jax.scene import Scene, obstacle_boxes

# Of equally good routes the first wins; others follow by name.
BRANCH_ORDER = ("direct", "under", "left", "right")
AXES = np.eye(2)
TOUCHING = 1e-6  # [m] a path along a face is beside the obstacle


def branch_rank(branch: str) -> tuple[int, str]:
    """Sorting key of the fixed order in which ties between routes are broken."""
    return (BRANCH_ORDER.index(branch) if branch in BRANCH_ORDER else len(BRANCH_ORDER), branch)


def branch_name(scene: Scene, poses: np.ndarray) -> str:
    """How a path passes the obstacles, in the words of whoever walks along it.

    Per obstacle of the settings, whatever it is made of: "under" when the torso is ever below it, also between its
        legs; else, unless the whole path lies beyond one of its faces, "left" or "right" by the way in
        which the path goes round it ("left": the obstacle stays on the right). Joined by "+" for several obstacles;
        "direct" when nothing of it applies.

    Args:
        scene: with all obstacles.
        poses: at the nodes, shape (T+1, 4).
    """
    names = []
    torso, heights = scene.torso_half_size, poses[:, 2]
    for boxes in obstacle_boxes(scene):
        center, half = scene.obstacle_centers[boxes[0]], scene.obstacle_half_sizes[boxes[0]]  # around all of them
        yaw = scene.obstacle_yaws[boxes[0]]
        apart = poses[:, :2] - center[:2]
        turn = poses[:, 3] - yaw
        along, across = _turned(apart, yaw)
        reach_along, reach_across = (half[i] + support(torso[:2], AXES[i], turn) for i in (0, 1))
        own_along, own_across = _turned(apart, poses[:, 3])
        overlaps = (
            (np.abs(along) < reach_along - TOUCHING)
            & (np.abs(across) < reach_across - TOUCHING)
            & (np.abs(own_along) < torso[0] + support(half[:2], AXES[0], turn) - TOUCHING)
            & (np.abs(own_across) < torso[1] + support(half[:2], AXES[1], turn) - TOUCHING)
        )
        if overlaps.any():
            names.append("under")
            continue
        low = min(float(scene.obstacle_centers[box, 2] - scene.obstacle_half_sizes[box, 2]) for box in boxes)
        beyond = (
            (along >= reach_along).all()
            or (along <= -reach_along).all()
            or (across >= reach_across).all()
            or (across <= -reach_across).all()
            or bool((heights + torso[2] <= low).all())
        )
        if not beyond:
            turned = np.unwrap(np.arctan2(apart[:, 1], apart[:, 0]))
            names.append("left" if turned[-1] < turned[0] else "right")
    return "+".join(dict.fromkeys(names)) or "direct"


def _turned(points: np.ndarray, yaw: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of points, shape (n, 2), along axes that are turned by a yaw, shape (n,) each."""
    cos, sin, (x, y) = np.cos(yaw), np.sin(yaw), points.T
    return cos * x + sin * y, cos * y - sin * x
