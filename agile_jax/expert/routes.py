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

from agile_jax.expert.edges import Boundary, Passage, round_edge
from agile_jax.expert.minimum_time import minimum_time, route_bounds
from agile_jax.expert.regions import CONTAINMENT, FreeSpace, Region, Side, clip_by_sides, holds
from agile_jax.expert.separation import Polygon, clip
from agile_jax.expert.settings import ExpertSettings

BRANCH_ORDER = (
    "direct",
    "under",
    "left",
    "right",
    "over",
)  # of equally good routes the first wins; others follow by name
MAX_EXPANSIONS = 20_000


class Route(NamedTuple):
    """A sequence of P regions, one for each phase."""

    regions: tuple[Region, ...]
    boundaries: tuple[Boundary, ...]  # between phases p and p + 1, P - 1 of them
    detours: int  # passages that are not pinned on the slower horizontal axis
    duration_bound: float  # [s]
    objective_bound: float

    @property
    def pins(self) -> tuple[Side, ...]:
        """The sides whose faces are the boundaries."""
        return tuple(boundary.pin for boundary in self.boundaries)


def branch_rank(branch: str) -> tuple[int, str]:
    """Sorting key of the fixed order in which ties between routes are broken."""
    return (BRANCH_ORDER.index(branch) if branch in BRANCH_ORDER else len(BRANCH_ORDER), branch)


def branch_name(space: FreeSpace, route: Route, poses: np.ndarray) -> str:
    """How a path along a route passes the obstacles, in the words of someone looking along +x.

    Per obstacle: "under" or "over" when the torso is ever below or above it, else "left" or "right" when the route
        changes its side of the obstacle by way of that side. Joined by "+" for several obstacles; "direct" when
        nothing of it applies.

    Args:
        poses: of the nodes, shape (T+1, 4).
    """
    names = []
    for obstacle, sides in enumerate(space.sides):
        inside = np.ones(len(poses), bool)
        for side in sides:
            if side.name and side.axis != 2:
                inside &= poses[:, :3] @ side.normal < side.value - space.margin
        taken = [sides[region.sides[obstacle]].name for region in route.regions]
        lateral = [name for name in taken if name in ("left", "right")]
        if inside.any():
            names.append("under" if poses[inside][0, 2] < space.heights[obstacle] else "over")
        elif len(set(taken)) > 1 and lateral:
            names.append(lateral[0])
    return "+".join(dict.fromkeys(names)) or "direct"


def find_routes(
    space: FreeSpace,
    start: np.ndarray,
    target: np.ndarray,
    settings: ExpertSettings,
    initial_velocity: str,
    rounded: bool = False,
) -> Iterator[Route]:
    """Yield every route from `start` to `target`, poses of shape (4,), by increasing lower bound of its objective.

    With `rounded` edges, a route has a phase around each edge that it passes (edges.py).

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
    known: dict[int, dict[int, Passage]] = {}

    ends = (start, target) if rounded else None

    def neighbours(i: int) -> dict[int, Passage]:
        if i not in known:
            known[i] = dict(sorted(_neighbours(space, regions[i], index, priority, ends), key=lambda pair: pair[0]))
        return known[i]

    def passages(path: tuple[int, ...]) -> list[Passage]:
        return [neighbours(i)[j] for i, j in itertools.pairwise(path)]

    def bounds(path: tuple[int, ...]) -> tuple[float, float]:
        boxes = [(b.lower, b.upper) for passage in passages(path) for b in passage.boundaries]
        return route_bounds(start, boxes, target, settings, initial_velocity)

    heap: list[tuple[float, tuple[int, ...]]] = []

    def push(path: tuple[int, ...]) -> None:
        heapq.heappush(heap, (bounds(path)[1], path))

    for i in range(len(regions)):
        if holds_start[i]:
            push((i,))
    expansions = 0
    while heap and expansions < MAX_EXPANSIONS:
        expansions += 1
        _, path = heapq.heappop(heap)
        if holds_target[path[-1]]:
            crossed = passages(path)
            phases = [regions[path[0]]]
            for passage, j in zip(crossed, path[1:], strict=True):
                phases += [regions[j]] if passage.between is None else [passage.between, regions[j]]
            detours = sum(passage.boundaries[0].pin.axis != priority[0] for passage in crossed)
            boundaries = tuple(boundary for passage in crossed for boundary in passage.boundaries)
            yield Route(tuple(phases), boundaries, detours, *bounds(path))
            continue
        for j in neighbours(path[-1]):
            if not holds_start[j] and not _returns([regions[i] for i in path], regions[j]):
                push((*path, j))


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
    space: FreeSpace,
    region: Region,
    index: dict[tuple[int, ...], int],
    priority: list[int],
    ends: tuple[np.ndarray, np.ndarray] | None,
) -> Iterator[tuple[int, Passage]]:
    """Regions that differ from one in the side of one obstacle, with the passage to them; its edge is rounded when
    start and target (`ends`) are given."""
    for obstacle, side in enumerate(region.sides):
        for other in range(len(space.sides[obstacle])):
            j = index.get((*region.sides[:obstacle], other, *region.sides[obstacle + 1 :]))
            if other != side and j is not None:
                boundary = _boundary(space, obstacle, region, space.regions[j], priority)
                if boundary is not None:
                    around = ends and round_edge(space, obstacle, region, space.regions[j], boundary.pin, ends)
                    yield j, around or Passage((boundary,))


def _boundary(space: FreeSpace, obstacle: int, a: Region, b: Region, priority: list[int]) -> Boundary | None:
    """Where a path goes over from one region to another: on a face, out of the two sides of the obstacle, that passes
    through their intersection; None when there is none."""
    low, high = np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper)
    if (low > high).any():
        return None
    faces = [space.sides[obstacle][region.sides[obstacle]] for region in (a, b)]
    for pin in sorted((face for face in faces if face.normal.any()), key=lambda face: priority.index(face.axis)):
        box = _pinned_box(space, pin, b, a.polygon, low.copy(), high.copy())
        if box is not None:
            return Boundary(pin, *box)
    return None


def _pinned_box(
    space: FreeSpace, pin: Side, other: Region, polygon: Polygon, low: np.ndarray, high: np.ndarray
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
