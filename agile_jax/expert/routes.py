"""Routes: sequences of regions from the start to the target, found in the order of their lower bound.

Consecutive regions differ in the side of one obstacle and intersect; a route ends in the first region that holds the
target and never comes back to one that holds the start (the rest of it would be a shorter route of its own). The
boundary between two regions is pinned to a face: where the path last leaves the old region, or first enters the new
one. Either exists on every path along the route, so the pin costs nothing, and it takes away the freedom to switch
anywhere in the overlap, which would make the labels ambiguous.
"""

import heapq
import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.minimum_time import minimum_time, route_bounds
from agile_jax.expert.regions import FreeSpace, Region, clip_by_sides, holds
from agile_jax.expert.separation import Polygon, clip
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.sides import CONTAINMENT, Face, Side

BRANCH_ORDER = (
    "direct",
    "under",
    "left",
    "right",
    "over",
)  # of equally good routes the first wins; others follow by name
LATERAL = ("left", "right", "front", "back")  # names of sides
TOUCHING = 1e-6  # [m] a path along a face is beside the obstacle
DIGITS = 9  # of bounds that differ [s]; rounding errors must not decide which route comes first
MAX_EXPANSIONS = 20_000


class Boundary(NamedTuple):
    """Where a route goes over from one region to the next."""

    pin: Face
    lower: np.ndarray  # (4,) box around it, of the pose
    upper: np.ndarray  # (4,)


class Route(NamedTuple):
    """A sequence of P regions."""

    regions: tuple[Region, ...]
    boundaries: tuple[Boundary, ...]  # between phases p and p + 1, P - 1 of them
    detours: int  # pins that are not on the slower horizontal axis
    duration_bound: float  # [s]
    objective_bound: float

    @property
    def pins(self) -> tuple[Face, ...]:
        """The faces that are the boundaries."""
        return tuple(boundary.pin for boundary in self.boundaries)


def branch_rank(branch: str) -> tuple[int, str]:
    """Sorting key of the fixed order in which ties between routes are broken."""
    return (BRANCH_ORDER.index(branch) if branch in BRANCH_ORDER else len(BRANCH_ORDER), branch)


def branch_name(space: FreeSpace, route: Route, poses: np.ndarray) -> str:
    """How a path along a route passes the obstacles, in the words of whoever walks along it.

    Per obstacle of the settings, whatever it is made of: "under" or "over" when the torso is ever below or above it,
        also between its legs; else, when the route changes its side of the obstacle, "left" or "right" by the way in
        which the path goes round it ("left": the obstacle stays on the right). Joined by "+" for several obstacles;
        "direct" when nothing of it applies.

    Args:
        poses: of the nodes, shape (T+1, 4).
    """
    names = []
    for obstacle, (sides, center) in enumerate(zip(space.sides, space.centers, strict=True)):
        inside = np.ones(len(poses), bool)
        for side in sides:
            if side.name in LATERAL and len(side.faces) == 1:
                inside &= poses[:, :3] @ side.faces[0].normal < side.faces[0].value - TOUCHING
        taken = {sides[region.sides[obstacle]].name for region in route.regions} - {""}
        if inside.any():
            names.append("under" if poses[inside][0, 2] < center[2] else "over")
        elif len(taken) > 1:
            x, y = (poses[:, :2] - center[:2]).T
            turned = np.unwrap(np.arctan2(y, x))
            names.append("left" if turned[-1] < turned[0] else "right")
    return "+".join(dict.fromkeys(names)) or "direct"


def find_routes(
    space: FreeSpace, start: np.ndarray, target: np.ndarray, settings: ExpertSettings, initial_velocity: str
) -> Iterator[Route]:
    """Yield every route from `start` to `target`, poses of shape (4,), by increasing lower bound of its objective.

    A* search over paths in the graph of regions that never return to a side of an obstacle that they have left: the
    lower bound never falls when a route gets longer.
    """
    regions = space.regions
    holds_start = [holds(space, region, start) for region in regions]
    holds_target = [holds(space, region, target) for region in regions]
    index = {region.sides: i for i, region in enumerate(regions)}
    # The axis that takes longest moves monotonically, and the fast path knows its motion; heights come last.
    times = minimum_time(target - start, np.array(settings.velocity), np.array(settings.acceleration), initial_velocity)
    priority = [*np.argsort(-times[:2], kind="stable").tolist(), 2]
    known: dict[int, dict[int, list[Boundary]]] = {}

    def neighbours(i: int) -> dict[int, list[Boundary]]:
        if i not in known:
            known[i] = dict(sorted(_neighbours(space, regions[i], index, priority), key=lambda pair: pair[0]))
        return known[i]

    def boundaries(path: tuple[int, ...], ways: tuple[int, ...]) -> list[Boundary]:
        return [neighbours(i)[j][way] for (i, j), way in zip(itertools.pairwise(path), ways, strict=True)]

    # Bound, number of regions, regions, which boundary between them: of equal bounds the simplest route comes first.
    heap: list[tuple[float, int, tuple[int, ...], tuple[int, ...]]] = []

    def push(path: tuple[int, ...], ways: tuple[int, ...]) -> None:
        boxes = [(boundary.lower, boundary.upper) for boundary in boundaries(path, ways)]
        bound = route_bounds(start, boxes, target, settings, initial_velocity)[1]
        heapq.heappush(heap, (round(bound, DIGITS), len(path), path, ways))

    for i in range(len(regions)):
        if holds_start[i]:
            push((i,), ())
    expansions = 0
    while heap and expansions < MAX_EXPANSIONS:
        expansions += 1
        _, _, path, ways = heapq.heappop(heap)
        if holds_target[path[-1]]:
            crossed = boundaries(path, ways)
            boxes = [(boundary.lower, boundary.upper) for boundary in crossed]
            bounds = route_bounds(start, boxes, target, settings, initial_velocity)
            detours = sum(boundary.pin.axis != priority[0] for boundary in crossed)
            yield Route(tuple(regions[i] for i in path), tuple(crossed), detours, *bounds)
            continue
        for j, between in neighbours(path[-1]).items():
            if not holds_start[j] and not _returns([regions[i] for i in path], regions[j]):
                for way in range(len(between)):
                    push((*path, j), (*ways, way))


def waypoints(route: Route, start: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Start, one point on each boundary, target, shape (P + 1, 4): the initial guess, a string pulled tight by fixed
    sweeps."""
    boxes = [(boundary.lower, boundary.upper) for boundary in route.boundaries]
    points = [start, *(np.clip(start, low, high) for low, high in boxes), target]
    for _ in range(30):
        for p, (low, high) in enumerate(boxes, start=1):
            before, after = points[p - 1], points[p + 1]
            ahead = np.linalg.norm(points[p] - before) + 1e-3
            behind = np.linalg.norm(after - points[p]) + 1e-3
            points[p] = np.clip((before * behind + after * ahead) / (ahead + behind), low, high)
    return np.array(points)


def _neighbours(
    space: FreeSpace, region: Region, index: dict[tuple[int, ...], int], priority: list[int]
) -> Iterator[tuple[int, list[Boundary]]]:
    """Regions that differ from one in the side of one obstacle, with the boundaries in between."""
    for obstacle, side in enumerate(region.sides):
        for other in range(len(space.sides[obstacle])):
            j = index.get((*region.sides[:obstacle], other, *region.sides[obstacle + 1 :]))
            if other != side and j is not None:
                boundaries = _boundaries(space, obstacle, region, space.regions[j], priority)
                if boundaries:
                    yield j, boundaries


def _boundaries(space: FreeSpace, obstacle: int, a: Region, b: Region, priority: list[int]) -> list[Boundary]:
    """Where a path goes over from one region to another: on the faces of the old or of the new side of the obstacle
    that pass through their intersection; empty when there are none.

    Every path last leaves the old side through one of its faces, and first enters the new one through one of its own:
    whichever side has fewer serves.
    """
    low, high = np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper)
    if (low > high).any():
        return []
    sides = [space.sides[obstacle][region.sides[obstacle]] for region in (a, b)]
    choices = [_only_of(side, other) for side, other in (sides, sides[::-1])]
    for pins in sorted(filter(None, choices), key=lambda pins: (len(pins), priority.index(pins[0].axis))):
        boxes = [(pin, _pinned_box(space, pin, b, a.polygon, low.copy(), high.copy())) for pin in pins]
        found = [Boundary(pin, *box) for pin, box in boxes if box is not None]
        if found:
            return found
    return []


def _only_of(side: Side, other: Side) -> list[Face]:
    """The faces of a side that another side of the obstacle has not; empty when paths cannot be pinned to all."""
    others = {(*face.normal, face.value) for face in other.faces}
    own = [face for face in side.faces if (*face.normal, face.value) not in others]
    return own if all(face.normal.any() for face in own) else []


def _pinned_box(
    space: FreeSpace, pin: Face, other: Region, polygon: Polygon, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The box around where a face, for some yaw, passes through the intersection of a region's polygon, another region
    and a box of poses."""
    axis = pin.axis
    if not space.exact or axis == 2:
        value = pin.normal[axis] * pin.value
        if not low[axis] <= value <= high[axis]:
            return None
        low[axis] = high[axis] = value
        if not space.exact:
            return low, high
    sides = [space.sides[o][side] for o, side in enumerate(other.sides)]
    polygon = clip_by_sides(polygon, sides, low, high)
    if axis != 2:
        normal = pin.normal[:2]
        polygon = clip(polygon, normal, pin.value) if polygon else polygon
        polygon = clip(polygon, -normal, -(pin.value + pin.reach)) if polygon else polygon
    if not polygon:
        return None
    low[:2], high[:2] = np.maximum(low[:2], np.min(polygon, axis=0)), np.minimum(high[:2], np.max(polygon, axis=0))
    return None if (low > high + CONTAINMENT).any() else (np.minimum(low, high), high)


def _returns(path: Sequence[Region], region: Region) -> bool:
    """Whether a region is on a side of an obstacle that the path has been on and left."""
    for obstacle, side in enumerate(region.sides):
        if path[-1].sides[obstacle] != side and any(before.sides[obstacle] == side for before in path):
            return True
    return False
