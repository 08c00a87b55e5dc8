"""Free space as a union of regions of poses.

The path keeps clear of an obstacle while the torso lies beyond one of its faces, or, where the obstacle is made of
several boxes, in one of the largest boxes that hold none of them (cells.py). One such cell per obstacle, within the
bounds of the pose, is a `Region`. Nodes k and k+1 in the same region cannot cut a corner between them. There are two
accounts of it:

- boxes: the torso's footprint over every yaw between start and target is covered by one axis-aligned rectangle, each
  obstacle by its own bounding rectangle. Regions are axis-aligned boxes of poses. Exact when the yaw does not change
  and everything is parallel to the axes, conservative otherwise; what the fast path needs.
- exact: faces keep the obstacle's yaw, and the footprint is that of the yaw at hand (rows of the program). Boxes around
  these regions serve the search for routes and its lower bounds.

Around an edge two cells make a square corner; edges.py rounds it.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.cells import CONTAINMENT, PARALLEL, Cell, box_cells, exact_cells
from agile_jax.expert.space.polygons import Polygon, clip
from agile_jax.geometry import support
from agile_jax.scene import obstacle_boxes

# Where only nodes are bounded: the path between two is a parabola that leaves the box of its end points by at most
# a h^2 / 8, 0.4 mm for 1.5 m/s^2 and 46 ms.
TIGHTENING = 5e-4  # [m]
ROUNDING_ERRORS = 1e-6  # [m] what the solver's tolerance needs
YAW_SLACK = 1e-3  # [rad] an interval of yaw that is a point would leave the solver no interior

Choice = tuple[int, ...]  # a region, by the index of its cell, per obstacle


class Region(NamedTuple):
    """Poses that are free of all obstacles: in one cell of each."""

    cells: Choice
    lower: np.ndarray  # (4,)
    upper: np.ndarray  # (4,)
    rows: np.ndarray  # (m, 4) of the faces that the torso's corners keep beyond; (0, 4) in boxes
    polygon: Polygon  # around its positions in the plane; empty in boxes, whose bounds say it all
    edge: np.ndarray | None = None  # (2, 4) faces, not enlarged, of the edge that it rounds (edges.py)


class FreeSpace(NamedTuple):
    """What all regions for one pair of start and target are made of. There is one for every choice of cells, six or
    more to the power of the number of obstacles, so they are made when they are asked for (`make_region`)."""

    cells: tuple[tuple[Cell, ...], ...]  # per obstacle
    lower: np.ndarray  # (4,) bounds of the pose
    upper: np.ndarray  # (4,)
    half_size: np.ndarray  # (3,) of the torso
    exact: bool  # whether faces have rows
    margin: float  # by which the faces are enlarged [m]


def planning_margin(settings: ExpertSettings) -> float:
    """The clearance that starts and targets need [m].

    The fast path keeps it at its nodes, so that the path between them keeps `clearance_margin`.
    """
    return settings.clearance_margin + TIGHTENING


def boxes_suffice(problem: Problem) -> bool:
    """Whether axis-aligned boxes describe the free space exactly: constant yaw, obstacles parallel to the axes."""
    scene, start = problem.scene, problem.start
    quarter_turns = scene.obstacle_yaws / (np.pi / 2)
    parallel = np.abs(quarter_turns - np.round(quarter_turns)) < PARALLEL
    return len(scene.obstacle_yaws) == 0 or (
        abs(float(start[3] - scene.target[3])) < YAW_SLACK and bool(parallel.all())
    )


def make_free_space(problem: Problem, exact: bool = False, reserve: float = TIGHTENING) -> FreeSpace:
    """The cells of all obstacles for one problem.

    Args:
        problem: its scene, start and margin count.
        exact: faces with the obstacle's yaw and rows, instead of boxes.
        reserve: of the margin and of the bounds of the pose, for what happens between nodes [m].
    """
    scene, start = problem.scene, problem.start
    inset = np.minimum(reserve, (scene.upper - scene.lower) / 4)
    lower = np.minimum(scene.lower + inset, np.minimum(start, scene.target))
    upper = np.maximum(scene.upper - inset, np.maximum(start, scene.target))
    lower[3] = max(min(start[3], scene.target[3]) - YAW_SLACK, scene.lower[3])
    upper[3] = min(max(start[3], scene.target[3]) + YAW_SLACK, scene.upper[3])
    margin = problem.settings.clearance_margin + reserve
    end_poses = (start, scene.target)
    per_obstacle = []
    for boxes in obstacle_boxes(scene):
        cells = (exact_cells if exact else box_cells)(scene, boxes, margin, lower, upper, end_poses)
        per_obstacle.append(tuple(cell for cell in cells if (cell.lower <= cell.upper).all()))
    return FreeSpace(tuple(per_obstacle), lower, upper, scene.torso_half_size, exact, margin)


def make_region(space: FreeSpace, choice: Choice) -> Region | None:
    """The region in one cell of each obstacle, by the cells' indices; None when it is empty."""
    chosen = [cells[i] for i, cells in zip(choice, space.cells, strict=True)]
    low = np.max([space.lower, *(cell.lower for cell in chosen)], axis=0)
    high = np.min([space.upper, *(cell.upper for cell in chosen)], axis=0)
    if (low > high).any():
        return None
    polygon: Polygon = ()
    rows: list[np.ndarray] = []
    if space.exact:
        polygon = clip_by_cells(rectangle(low, high), chosen, low, high)
        if not polygon:
            return None
        low[:2], high[:2] = np.min(polygon, axis=0), np.max(polygon, axis=0)
        rows = [row for cell in chosen for row in cell.rows]
    return Region(choice, low, high, np.array(rows).reshape(-1, 4), polygon)


def regions_around(space: FreeSpace, pose: np.ndarray) -> list[Region]:
    """The regions that hold a pose, shape (4,), in a fixed order."""
    per_obstacle = ([i for i, cell in enumerate(cells) if _in_box(cell, pose)] for cells in space.cells)
    regions = (make_region(space, choice) for choice in product(*per_obstacle))
    return [region for region in regions if region is not None and holds(space, region, pose)]


def rectangle(low: np.ndarray, high: np.ndarray) -> Polygon:
    """The polygon of a box of poses in the plane."""
    return [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]


def clip_by_cells(polygon: Polygon, cells: Sequence[Cell], low: np.ndarray, high: np.ndarray) -> Polygon:
    """What the cells' faces, with their least footprints, leave of a polygon at heights between low and high."""
    for face in (face for cell in cells for face in cell.faces):
        if face.row is not None:
            nx, ny, nz, offset = face.row
            polygon = clip(polygon, (nx, ny), offset + face.least - max(nz * low[2], nz * high[2]))
    return polygon


def holds(space: FreeSpace, region: Region, pose: np.ndarray) -> bool:
    """Whether a pose, shape (4,), is in a region."""
    if not _in_box(region, pose):
        return False
    if not space.exact:
        return True
    footprint = support(space.half_size[:2], region.rows[:, :2], pose[3])
    beyond = region.rows[:, :3] @ pose[:3] - footprint - region.rows[:, 3]
    return bool((beyond >= -CONTAINMENT).all())


def _in_box(part: Cell | Region, pose: np.ndarray) -> bool:
    """Whether a pose is in the box around a cell or region."""
    inside = zip(part.lower.tolist(), pose.tolist(), part.upper.tolist(), strict=True)
    return all(low - CONTAINMENT <= value <= high + CONTAINMENT for low, value, high in inside)
