"""Free space as a union of regions of poses.

The path keeps clear of an obstacle while the torso lies beyond one of its faces, or, where the obstacle is made of
several boxes, in one of the largest boxes that hold none of them (sides.py). One such side per obstacle, within the
bounds of the pose, is a `Region`. Nodes k and k+1 in the same region cannot cut a corner between them. There are two
accounts of it:

- boxes: the torso's footprint over every yaw between start and target is covered by one axis-aligned rectangle, each
  obstacle by its own bounding rectangle. Regions are axis-aligned boxes of poses. Exact when the yaw does not change
  and everything is parallel to the axes, conservative otherwise; what the fast path needs.
- exact: faces keep the obstacle's yaw, and the footprint is that of the yaw at hand (rows of the program). Boxes around
  these regions serve the search for routes and its lower bounds.

Around an edge two sides make a square corner; edges.py rounds it.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.faces import CONTAINMENT, NO_ROW, PARALLEL, Side, box_sides, exact_sides
from agile_jax.expert.space.polygons import Polygon, clip
from agile_jax.geometry import rotation_2d
from agile_jax.scene import Scene, obstacle_boxes

# Where only nodes are bounded: the path between two is a parabola that leaves the box of its end points by at most
# a h^2 / 8, 0.4 mm for 1.5 m/s^2 and 46 ms.
TIGHTENING = 5e-4  # [m]
ROUNDING_ERRORS = 1e-6  # [m] what the solver's tolerance needs
YAW_SLACK = 1e-3  # [rad] an interval of yaw that is a point would leave the solver no interior

Choice = tuple[int, ...]  # a region, by the index of its side, per obstacle


class Region(NamedTuple):
    """Poses free of all obstacles: on one side of each."""

    sides: Choice
    lower: np.ndarray  # (4,)
    upper: np.ndarray  # (4,)
    faces: np.ndarray  # (m, 4) rows, `FreeSpace.rows` of each obstacle; (0, 4) in boxes
    polygon: Polygon  # around its positions in the plane; empty in boxes, whose bounds say it all
    edge: np.ndarray = np.empty((0, 4))  # (2, 4) faces, not enlarged, of the edge that it rounds (edges.py), if any


class FreeSpace(NamedTuple):
    """What all regions for one pair of start and target are made of. There is one for every choice of sides, six or
    more to the power of the number of obstacles, so they are made when they are asked for (`make_region`)."""

    sides: tuple[tuple[Side, ...], ...]  # per obstacle
    rows: tuple[int, ...]  # per obstacle, of the side with the most; the others are filled up with NO_ROW
    lower: np.ndarray  # (4,) bounds of the pose
    upper: np.ndarray  # (4,)
    half_size: np.ndarray  # (3,) of the torso
    exact: bool  # whether faces have rows
    margin: float  # by which the faces are enlarged [m]


def planning_margin(settings: ExpertSettings) -> float:
    """Clearance that starts and targets need, and that the fast path keeps at its nodes, so that the path between them
    keeps `clearance_margin` [m]."""
    return settings.clearance_margin + TIGHTENING


def boxes_suffice(scene: Scene, start: np.ndarray) -> bool:
    """Whether axis-aligned boxes describe the free space exactly: constant yaw, obstacles parallel to the axes."""
    quarter_turns = scene.obstacle_yaws / (np.pi / 2)
    parallel = np.abs(quarter_turns - np.round(quarter_turns)) < PARALLEL
    return len(scene.obstacle_yaws) == 0 or (
        abs(float(start[3] - scene.target[3])) < YAW_SLACK and bool(parallel.all())
    )


def make_free_space(
    scene: Scene, settings: ExpertSettings, start: np.ndarray, exact: bool = False, reserve: float = TIGHTENING
) -> FreeSpace:
    """The sides of all obstacles for one start pose, shape (4,).

    Args:
        exact: faces with the obstacle's yaw and rows, instead of boxes.
        reserve: of the margin and of the bounds of the pose, for what happens between nodes [m].
    """
    inset = np.minimum(reserve, (scene.upper - scene.lower) / 4)
    lower = np.minimum(scene.lower + inset, np.minimum(start, scene.target))
    upper = np.maximum(scene.upper - inset, np.maximum(start, scene.target))
    lower[3] = max(min(start[3], scene.target[3]) - YAW_SLACK, scene.lower[3])
    upper[3] = min(max(start[3], scene.target[3]) + YAW_SLACK, scene.upper[3])
    margin = settings.clearance_margin + reserve
    ends = (start, scene.target)
    per_obstacle = []
    for boxes in obstacle_boxes(scene):
        sides = (exact_sides if exact else box_sides)(scene, boxes, margin, lower, upper, ends)
        per_obstacle.append(tuple(side for side in sides if (side.lower <= side.upper).all()))
    rows = tuple(max([1, *(len(side.rows) for side in sides)]) for sides in per_obstacle)
    return FreeSpace(tuple(per_obstacle), rows, lower, upper, scene.torso_half_size, exact, margin)


def make_region(space: FreeSpace, choice: Choice) -> Region | None:
    """The region on one side of each obstacle, by the sides' indices; None when it is empty."""
    chosen = [sides[i] for i, sides in zip(choice, space.sides, strict=True)]
    low = np.max([space.lower, *(side.lower for side in chosen)], axis=0)
    high = np.min([space.upper, *(side.upper for side in chosen)], axis=0)
    if (low > high).any():
        return None
    polygon: Polygon = ()
    rows: list[np.ndarray] = []
    if space.exact:
        polygon = clip_by_sides(rectangle(low, high), chosen, low, high)
        if not polygon:
            return None
        low[:2], high[:2] = np.min(polygon, axis=0), np.max(polygon, axis=0)
        for side, count in zip(chosen, space.rows, strict=True):
            rows += side.rows + [NO_ROW] * (count - len(side.rows))
    return Region(choice, low, high, np.array(rows).reshape(-1, 4), polygon)


def regions_around(space: FreeSpace, pose: np.ndarray) -> list[Region]:
    """The regions that hold a pose, shape (4,), in a fixed order."""
    per_obstacle = ([i for i, side in enumerate(sides) if _in_box(side, pose)] for sides in space.sides)
    regions = (make_region(space, choice) for choice in product(*per_obstacle))
    return [region for region in regions if region is not None and holds(space, region, pose)]


def rectangle(low: np.ndarray, high: np.ndarray) -> Polygon:
    """The polygon of a box of poses in the plane."""
    return [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]


def clip_by_sides(polygon: Polygon, sides: Sequence[Side], low: np.ndarray, high: np.ndarray) -> Polygon:
    """What the sides' faces, with their least footprints, leave of a polygon at heights between low and high."""
    for face in (face for side in sides for face in side.faces):
        nx, ny, nz, offset = face.row
        if nx or ny:
            polygon = clip(polygon, (nx, ny), offset + face.least - max(nz * low[2], nz * high[2]))
    return polygon


def holds(space: FreeSpace, region: Region, pose: np.ndarray) -> bool:
    """Whether a pose, shape (4,), is in a region."""
    if not _in_box(region, pose):
        return False
    if not space.exact:
        return True
    turned = rotation_2d(pose[3]).T @ region.faces[:, :2].T  # (2, n) normals in the torso's frame
    footprint = space.half_size[:2] @ np.abs(turned)
    beyond = region.faces[:, :3] @ pose[:3] - footprint - region.faces[:, 3]
    return bool((beyond >= -CONTAINMENT).all())


def _in_box(part: Side | Region, pose: np.ndarray) -> bool:
    """Whether a pose is in the box around a side or region."""
    inside = zip(part.lower.tolist(), pose.tolist(), part.upper.tolist(), strict=True)
    return all(low - CONTAINMENT <= value <= high + CONTAINMENT for low, value, high in inside)
