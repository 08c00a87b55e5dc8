"""Free space as a union of regions of poses.

The path keeps clear of an obstacle while the torso lies beyond one of its faces. One face per obstacle, within the
bounds of the pose, is a `Region`. Nodes k and k+1 in the same region cannot cut a corner between them. There are two
accounts of it:

- boxes: the torso's footprint over every yaw between start and target is covered by one axis-aligned rectangle, each
  obstacle by its own bounding rectangle. Regions are axis-aligned boxes of poses. Exact when the yaw does not change
  and everything is parallel to the axes, conservative otherwise; what the fast path needs.
- exact: faces keep the obstacle's yaw, and the footprint is that of the yaw at hand (rows of the program). Boxes around
  these regions serve the search for routes and its lower bounds.

A pose can keep the margin without being beyond any face, diagonally off an edge: such a start or target gets a side of
its own.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from agile_jax.expert.footprint import footprint, footprint_range
from agile_jax.expert.separation import Polygon, clip, planar_separation
from agile_jax.expert.settings import ExpertSettings
from agile_jax.geometry import rotation_2d
from agile_jax.scene import POSE_SIZE, Scene, obstacle_clearances
from agile_jax.settings import BadInput

# The path between two nodes is a parabola that leaves the box of its end points by at most a h^2 / 8: 0.4 mm for 1.5
# m/s^2 and 46 ms.
TIGHTENING = 5e-4  # [m]
CONTAINMENT = 1e-9  # [m]
YAW_SLACK = 1e-3  # [rad] an interval of yaw that is a point would leave the solver no interior
FACES = (("left", 1, +1), ("right", 1, -1), ("front", 0, -1), ("back", 0, +1), ("under", 2, -1), ("over", 2, +1))
PARALLEL = 1e-9  # [rad] an obstacle nearer to the axes than this is parallel to them
NO_ROW = np.array([0.0, 0.0, 0.0, -1.0])  # a face that is always kept


class Side(NamedTuple):
    """A convex part of the space around one obstacle."""

    name: str  # a face's name, or "" for the part around a start or target that is diagonally off an edge
    normal: np.ndarray  # (3,) of the face, away from the obstacle; zero where there is no face to pin to
    value: float  # the pose's position along the normal when the torso touches the face with its least footprint [m]
    reach: float  # how much larger that can be with other yaws [m]
    least: float  # footprint [m] on that face
    face: np.ndarray  # (4,) normal and offset of the face that the corners keep beyond; NO_ROW in boxes
    lower: np.ndarray  # (4,) box around it, of the pose
    upper: np.ndarray  # (4,)

    @property
    def axis(self) -> int:
        """The axis that the normal is nearest to."""
        sizes = [abs(component) for component in self.normal.tolist()]
        return sizes.index(max(sizes))


class Region(NamedTuple):
    """Poses free of all obstacles: on one side of each."""

    sides: tuple[int, ...]  # index of the side, per obstacle
    lower: np.ndarray  # (4,)
    upper: np.ndarray  # (4,)
    faces: np.ndarray  # (n, 4) per obstacle
    polygon: Polygon  # around its positions in the plane; empty in boxes, whose bounds say it all


class FreeSpace(NamedTuple):
    """What the regions for one pair of start and target are made of, one for every choice of sides (`make_region`)."""

    sides: tuple[tuple[Side, ...], ...]  # per obstacle
    heights: tuple[float, ...]  # of the obstacles' centres [m]
    lower: np.ndarray  # (4,) bounds of the pose
    upper: np.ndarray  # (4,)
    half_size: np.ndarray  # (3,) of the torso
    exact: bool  # whether faces have rows


def planning_margin(settings: ExpertSettings) -> float:
    """Clearance that the plan keeps at its nodes, so that the path between them keeps `clearance_margin` [m]."""
    return settings.clearance_margin + TIGHTENING


def check_start(scene: Scene, settings: ExpertSettings, start: np.ndarray) -> None:
    """Refuse a start pose, shape (4,), from which no plan can begin.

    Raises: BadInput: outside the bounds, inside an obstacle, or within the margin of one. The message names value and
        allowed range.
    """
    start = np.asarray(start, float)
    if start.shape != (POSE_SIZE,) or not np.isfinite(start).all():
        raise BadInput(f"start = {start.tolist()} must be {POSE_SIZE} finite numbers: x y z yaw [m, m, m, rad]")
    for name, unit, value, low, high in zip(
        ["x", "y", "z", "yaw"], ["m", "m", "m", "rad"], start, scene.lower, scene.upper, strict=True
    ):
        if not low <= value <= high:
            raise BadInput(f"start {name} = {value:g} {unit} is outside its bounds [{low:g}, {high:g}] {unit}")
    _check_clearance(scene, settings, start, "start")


def check_target(scene: Scene, settings: ExpertSettings) -> None:
    """Refuse a target that keeps less than the margin (BadInput): no plan could end there."""
    _check_clearance(scene, settings, scene.target, "target")


def _check_clearance(scene: Scene, settings: ExpertSettings, pose: np.ndarray, name: str) -> None:
    for i, distance in enumerate(obstacle_clearances(scene, pose)):
        if distance < planning_margin(settings):
            where = "inside" if distance < 0 else f"{distance:.4f} m from"
            raise BadInput(
                f"{name} = {pose.tolist()} puts the torso {where} obstacle {i} (clearance {distance:.4f} m); "
                f"at least {planning_margin(settings):g} m is needed"
            )


def boxes_suffice(scene: Scene, start: np.ndarray) -> bool:
    """Whether axis-aligned boxes describe the free space exactly: constant yaw, obstacles parallel to the axes."""
    quarter_turns = scene.obstacle_yaws / (np.pi / 2)
    parallel = np.abs(quarter_turns - np.round(quarter_turns)) < PARALLEL
    return len(scene.obstacle_yaws) == 0 or (
        abs(float(start[3] - scene.target[3])) < YAW_SLACK and bool(parallel.all())
    )


def make_free_space(scene: Scene, settings: ExpertSettings, start: np.ndarray, exact: bool = False) -> FreeSpace:
    """The sides of all obstacles for one start pose, shape (4,)."""
    lower, upper = scene.lower.astype(float), scene.upper.astype(float)
    lower[3] = min(start[3], scene.target[3]) - YAW_SLACK
    upper[3] = max(start[3], scene.target[3]) + YAW_SLACK
    margin = planning_margin(settings)
    ends = (start, scene.target)
    per_obstacle = []
    for i in range(len(scene.obstacle_centers)):
        sides = (_exact_sides if exact else _box_sides)(scene, i, margin, lower, upper, ends)
        per_obstacle.append(tuple(side for side in sides if (side.lower <= side.upper).all()))

    heights = tuple(scene.obstacle_centers[:, 2].tolist())
    return FreeSpace(tuple(per_obstacle), heights, lower, upper, scene.torso_half_size, exact)


def make_region(space: FreeSpace, choice: tuple[int, ...]) -> Region | None:
    """The region on one side of each obstacle, by the sides' indices; None when it is empty."""
    chosen = [sides[i] for i, sides in zip(choice, space.sides, strict=True)]
    low = np.max([space.lower, *(side.lower for side in chosen)], axis=0)
    high = np.min([space.upper, *(side.upper for side in chosen)], axis=0)
    if (low > high).any():
        return None
    polygon: Polygon = ()
    if space.exact:
        polygon = clip_by_sides(rectangle(low, high), chosen, low, high)
        if not polygon:
            return None
        low[:2], high[:2] = np.min(polygon, axis=0), np.max(polygon, axis=0)
    return Region(choice, low, high, np.array([side.face for side in chosen]).reshape(-1, 4), polygon)


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
    for side in sides:
        nx, ny, nz, offset = side.face
        if nx or ny:
            polygon = clip(polygon, (nx, ny), offset + side.least - max(nz * low[2], nz * high[2]))
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


def _box_sides(
    scene: Scene, i: int, margin: float, lower: np.ndarray, upper: np.ndarray, ends: tuple[np.ndarray, np.ndarray]
) -> list[Side]:
    """The sides of obstacle i's bounding box, for the footprint over the whole interval of yaw."""
    torso = np.append(footprint(scene.torso_half_size, (lower[3], upper[3])), scene.torso_half_size[2])
    center, yaw = scene.obstacle_centers[i], scene.obstacle_yaws[i]
    half = np.append(footprint(scene.obstacle_half_sizes[i], (yaw, yaw)), scene.obstacle_half_sizes[i, 2])
    body = torso + half  # touching
    sides = []
    for name, axis, sign in FACES:
        normal = np.zeros(3)
        normal[axis] = sign
        value = float(normal @ center + body[axis] + margin)
        low, high = half_space_box(normal, value, lower, upper)
        sides.append(Side(name, normal, value, 0.0, 0.0, NO_ROW, low, high))
    cells = [_cell(pose, center, body, margin, lower, upper) for pose in ends]
    return [*sides, *(cell for cell in cells if cell is not None)]


def _exact_sides(
    scene: Scene, i: int, margin: float, lower: np.ndarray, upper: np.ndarray, ends: tuple[np.ndarray, np.ndarray]
) -> list[Side]:
    """The sides of obstacle i with its own yaw; the footprint is left to the rows."""
    center, half = scene.obstacle_centers[i], scene.obstacle_half_sizes[i]
    torso, yaws = scene.torso_half_size, (lower[3], upper[3])
    turn = round(float(scene.obstacle_yaws[i]) / (np.pi / 2))
    yaw = float(scene.obstacle_yaws[i]) - turn * np.pi / 2  # names of faces go by the nearest axis
    planar = half[:2] if turn % 2 == 0 else half[1::-1]
    rotation = np.eye(3)
    rotation[:2, :2] = rotation_2d(yaw)

    def side(name: str, normal: np.ndarray, offset: float) -> Side:
        """Poses p with n.p - footprint(n, yaw) >= offset."""
        least, most = footprint_range(torso, normal, yaws)
        low, high = half_space_box(normal, offset + least, lower, upper)
        flat = bool(np.abs(normal[:2]).max() == 0)  # under and over are bounds, they need no row
        face = NO_ROW if flat else np.append(normal, offset)
        return Side(name, normal, offset + least, most - least, least, face, low, high)

    sides = []
    for name, axis, sign in FACES:
        normal = sign * rotation[:, axis]
        sides.append(side(name, normal, float(normal @ center + np.append(planar, half[2] + torso[2])[axis] + margin)))
    for pose in ends:
        if any(_beyond(existing, pose, torso) for existing in sides):
            continue
        apart = planar_separation(
            pose[:2], torso[:2], float(pose[3]), center[:2], half[:2], float(scene.obstacle_yaws[i])
        )
        vertical = float(pose[2] - center[2])
        gap = max(abs(vertical) - half[2] - torso[2], 0.0)
        toward = np.append(apart, np.copysign(gap, vertical))  # from obstacle to torso
        if np.linalg.norm(toward) < margin:
            continue
        normal = toward / np.linalg.norm(toward)
        turned = rotation_2d(float(scene.obstacle_yaws[i])).T @ normal[:2]
        support = float(normal @ center + half[:2] @ np.abs(turned) + (half[2] + torso[2]) * abs(normal[2]))
        witness = side("", normal, support + margin)
        sides.append(witness._replace(normal=np.zeros(3)))
    return sides


def _beyond(side: Side, pose: np.ndarray, torso: np.ndarray) -> bool:
    """Whether a pose is on an exact side."""
    if side.face is NO_ROW:
        return _in_box(side, pose)
    footprint_now = torso[:2] @ np.abs(rotation_2d(pose[3]).T @ side.face[:2])
    return bool(side.face[:3] @ pose[:3] - footprint_now >= side.face[3] - CONTAINMENT)


def half_space_box(
    normal: np.ndarray, value: float, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The box around the part of a box of poses where normal . position >= value; lower > upper when it is empty."""
    low, high = lower.copy(), upper.copy()
    most = np.maximum(normal * lower[:3], normal * upper[:3])
    for axis in [i for i, component in enumerate(normal.tolist()) if abs(component) > PARALLEL]:
        needed = (value - (most.sum() - most[axis])) / normal[axis]
        if normal[axis] > 0:
            low[axis] = max(low[axis], needed)
        else:
            high[axis] = min(high[axis], needed)
    return low, high


def _cell(
    pose: np.ndarray, center: np.ndarray, body: np.ndarray, margin: float, lower: np.ndarray, upper: np.ndarray
) -> Side | None:
    """The box of poses that are on no axis nearer to the obstacle than `pose`.

    Diagonally off an edge a pose can keep the margin although it is within it on every axis, hence beyond no enlarged
    face. None for all other poses.
    """
    gaps = np.abs(pose[:3] - center) - body
    outside = gaps > 0
    if (gaps >= margin).any() or np.linalg.norm(gaps[outside]) < margin:
        return None
    low, high = lower.copy(), upper.copy()
    for axis in np.flatnonzero(outside):
        if pose[axis] > center[axis]:
            low[axis] = max(low[axis], pose[axis])
        else:
            high[axis] = min(high[axis], pose[axis])
    return Side("", np.zeros(3), 0.0, 0.0, 0.0, NO_ROW, low, high)
