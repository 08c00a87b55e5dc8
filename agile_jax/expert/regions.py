"""Free space as a union of axis-aligned boxes of poses.

The torso's footprint over every yaw between start and target is covered by one axis-aligned rectangle, each obstacle
by its own bounding rectangle; both are exact for yaw 0 and conservative otherwise. An obstacle enlarged by the torso
and the margin is then a box that a point must avoid, and outside it the point lies beyond one of its six faces. One
choice per obstacle, within the bounds of the pose, is a `Region`. A trajectory whose nodes k and k+1 lie in the same
region cannot cut a corner between them.
"""

from itertools import product
from typing import NamedTuple

import numpy as np

from agile_jax.expert.settings import ExpertSettings
from agile_jax.scene import POSE_SIZE, Scene, obstacle_clearances
from agile_jax.settings import BadInput

# The path between two nodes is a parabola that leaves the box of its end points by at most a h^2 / 8: 0.4 mm for 1.5
# m/s^2 and 46 ms.
TIGHTENING = 5e-4  # [m]
YAW_SLACK = 1e-3  # [rad] an interval of yaw that is a point would leave the solver no interior
FACES = (("left", 1, +1), ("right", 1, -1), ("front", 0, -1), ("back", 0, +1), ("under", 2, -1), ("over", 2, +1))


class Side(NamedTuple):
    """A convex part of the space around one obstacle."""

    name: str  # a face's name, or "" for the cell around a start or target that is diagonally off an edge
    axis: int  # of the face; -1 for a cell
    value: float  # of the pose on the face [m]
    lower: np.ndarray  # (4,) of the pose
    upper: np.ndarray  # (4,)


class Region(NamedTuple):
    """A box of poses free of all obstacles: one side of each."""

    sides: tuple[int, ...]  # index of the side, per obstacle
    lower: np.ndarray  # (4,)
    upper: np.ndarray  # (4,)


class FreeSpace(NamedTuple):
    """All regions for one pair of start and target."""

    sides: tuple[tuple[Side, ...], ...]  # per obstacle
    heights: tuple[float, ...]  # of the obstacles' centres [m]
    regions: tuple[Region, ...]


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


def footprint(half_size: np.ndarray, yaws: tuple[float, float]) -> np.ndarray:
    """Half sizes (2,) of the axis-aligned rectangle that holds a rectangle at every yaw in an interval [m]."""
    low, high = yaws
    result = []
    for a, b in ((half_size[0], half_size[1]), (half_size[1], half_size[0])):
        peak = np.arctan2(b, a)  # |a cos| + |b sin| is largest here, and by symmetry at the mirrored angles
        peaks = [sign * peak + turn * np.pi for sign in (-1, 1) for turn in range(-3, 4)]
        yaws_to_try = [low, high, *(p for p in peaks if low <= p <= high)]
        result.append(max(abs(a * np.cos(yaw)) + abs(b * np.sin(yaw)) for yaw in yaws_to_try))
    return np.array(result)


def make_free_space(scene: Scene, settings: ExpertSettings, start: np.ndarray) -> FreeSpace:
    """The regions for one start pose, shape (4,), in a fixed order."""
    lower, upper = scene.lower.astype(float), scene.upper.astype(float)
    lower[3] = min(start[3], scene.target[3]) - YAW_SLACK
    upper[3] = max(start[3], scene.target[3]) + YAW_SLACK
    torso = np.append(footprint(scene.torso_half_size, (lower[3], upper[3])), scene.torso_half_size[2])
    margin = planning_margin(settings)

    per_obstacle = []
    for center, half, yaw in zip(scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True):
        body = torso + np.append(footprint(half, (yaw, yaw)), half[2])  # touching
        sides = [_face(face, center, body + margin, lower, upper) for face in FACES]
        cells = [_cell(pose, center, body, margin, lower, upper) for pose in (start, scene.target)]
        per_obstacle.append(tuple(side for side in (*sides, *cells) if side is not None))

    regions = []
    for choice in product(*(range(len(sides)) for sides in per_obstacle)):
        chosen = [sides[i] for i, sides in zip(choice, per_obstacle, strict=True)]
        low = np.max([lower, *(side.lower for side in chosen)], axis=0)
        high = np.min([upper, *(side.upper for side in chosen)], axis=0)
        if (low <= high).all():
            regions.append(Region(choice, low, high))
    return FreeSpace(tuple(per_obstacle), tuple(scene.obstacle_centers[:, 2].tolist()), tuple(regions))


def _face(
    face: tuple[str, int, int], center: np.ndarray, half: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> Side | None:
    """The half space beyond one face, or None when the bounds leave nothing of it."""
    name, axis, sign = face
    value = float(center[axis] + sign * half[axis])
    low, high = lower.copy(), upper.copy()
    if sign > 0:
        low[axis] = max(low[axis], value)
    else:
        high[axis] = min(high[axis], value)
    return Side(name, axis, value, low, high) if low[axis] <= high[axis] else None


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
    return Side("", -1, 0.0, low, high)
