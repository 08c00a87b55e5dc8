"""Routes: sequences of regions from the start to the target, found in the order of their lower bound.

Consecutive regions differ in the side of one obstacle and intersect; a route ends in the first region that holds the
target and never comes back to one that holds the start (the rest of it would be a shorter route of its own). The
boundary between two regions is pinned to a face: where the path last leaves the old region, or first enters the new
one. Either exists on every path along the route, so the pin costs nothing, and it takes away the freedom to switch
anywhere in the overlap, which would make the labels ambiguous.
"""

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.minimum_time import minimum_time, route_bounds
from agile_jax.expert.profile import Profile
from agile_jax.expert.regions import (
    CONTAINMENT,
    FreeSpace,
    Region,
    Side,
    clip_by_sides,
    holds,
    make_region,
    regions_around,
)
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
ROUNDING = 1e-6  # relative, of the time that routes may take
PATHS = 8  # that are followed through one region, the best ones: they multiply with the number of obstacles
PATIENCE = 50  # expansions without a route after which it is asked whether there is any


Choice = tuple[int, ...]  # a region by the index of its side, per obstacle


class Boundary(NamedTuple):
    """Where a route goes over from one region to the next."""

    pin: Side  # on whose face
    lower: tuple[float, ...]  # (4,) box around it, of the pose
    upper: tuple[float, ...]  # (4,)


class Route(NamedTuple):
    """A sequence of P regions."""

    regions: tuple[Region, ...]
    boundaries: tuple[Boundary, ...]  # between phases p and p + 1, P - 1 of them
    detours: int  # pins that are not on the slower horizontal axis
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

    Per obstacle of the space, which are those that matter (relevant.py): "under" or "over" when the torso is ever below
        or above it, else "left" or "right" when the route changes its side of the obstacle by way of that side. Joined
        by "+" for several obstacles; "direct" when nothing of it applies.

    Args:
        poses: of the nodes, shape (T+1, 4).
    """
    names = []
    for obstacle, sides in enumerate(space.sides):
        inside = np.ones(len(poses), bool)
        for side in sides:
            if side.name and side.axis != 2:
                inside &= poses[:, :3] @ side.normal < side.value
        taken = [sides[region.sides[obstacle]].name for region in route.regions]
        lateral = [name for name in taken if name in ("left", "right")]
        if inside.any():
            names.append("under" if poses[inside][0, 2] < space.heights[obstacle] else "over")
        elif len(set(taken)) > 1 and lateral:
            names.append(lateral[0])
    return "+".join(dict.fromkeys(names)) or "direct"


class RouteSearch:
    """Every route from `start` to `target`, poses of shape (4,), by increasing lower bound of its objective.

    A* search over paths in the graph of regions that never return to a side of an obstacle that they have left: the
    lower bound never falls when a route gets longer. A longer path waits with the bound of the shorter one, and gets
    its own when its turn comes.

    Args:
        profile: of the slowest axis, when only routes are wanted that may take its time; the bounds are then for
            motions of that duration.
    """

    def __init__(
        self,
        space: FreeSpace,
        start: np.ndarray,
        target: np.ndarray,
        settings: ExpertSettings,
        initial_velocity: str,
        profile: Profile | None = None,
    ) -> None:
        # The axis that takes longest moves monotonically, and the fast path knows its motion; heights come last.
        bounds = np.array(settings.velocity), np.array(settings.acceleration)
        times = minimum_time(target - start, *bounds, initial_velocity)
        self._priority = (*np.argsort(-times[:2], kind="stable").tolist(), 2)
        self._graph = _Graph(space, self._priority, target)
        self._starts = {region.sides: region for region in regions_around(space, start)}
        self._graph.regions.update(self._starts)
        self._problem = (settings, initial_velocity)
        self._ends = (start.tolist(), target.tolist())
        self._known = None if profile is None else (profile.axis, profile.effort, profile.duration)
        self._longest = math.inf if profile is None else profile.duration * (1 + ROUNDING)
        # (bound, path, route); the last is None while the bound is that of the path without its end.
        self._heap: list[tuple[float, tuple[Choice, ...], Route | None]] = [
            (0.0, (choice,), None) for choice in sorted(self._starts)
        ]
        self.expansions = 0
        self._followed: dict[Choice, int] = {}  # how often, by the region where a path ends
        self._found = False

    def next(self, most: float = math.inf) -> Route | None:
        """The next route; None when there is none whose bound is at most `most`, which must never grow."""
        heap = self._heap
        while heap and heap[0][0] <= most and self.expansions < MAX_EXPANSIONS:
            bound, path, route = heapq.heappop(heap)
            if route is None:
                route = self._evaluate(bound, path)
                if route.duration_bound > self._longest or route.objective_bound > most:
                    continue
                if heap and route.objective_bound > heap[0][0]:
                    heapq.heappush(heap, (route.objective_bound, path, route))
                    continue
            if self._graph.ends(path[-1]):
                self._found = True
                return route
            self._followed[path[-1]] = followed = self._followed.get(path[-1], 0) + 1
            if followed > PATHS:
                continue
            self.expansions += 1
            if self.expansions == PATIENCE and not self._found and not self._graph.connects(self._starts):
                heap.clear()
                return None
            for choice in self._graph.neighbours(path[-1]):
                if choice not in self._starts and not _returns(path, choice):
                    heapq.heappush(heap, (route.objective_bound, (*path, choice), None))
        return None

    def _evaluate(self, bound: float, path: tuple[Choice, ...]) -> Route:
        graph, (start, target) = self._graph, self._ends
        crossed = tuple(graph.neighbours(a)[b] for a, b in itertools.pairwise(path))
        boxes = [(boundary.lower, boundary.upper) for boundary in crossed]
        duration, objective = route_bounds(start, boxes, target, *self._problem, self._known)
        detours = sum(boundary.pin.axis != self._priority[0] for boundary in crossed)
        return Route(tuple(graph.regions[c] for c in path), crossed, detours, duration, max(objective, bound))


def find_routes(
    space: FreeSpace, start: np.ndarray, target: np.ndarray, settings: ExpertSettings, initial_velocity: str
) -> Iterator[Route]:
    """Yield all routes in the order of `RouteSearch`."""
    search = RouteSearch(space, start, target, settings, initial_velocity)
    while (route := search.next()) is not None:
        yield route


class _Graph:
    """Regions and the boundaries between them, made when they are first asked for."""

    def __init__(self, space: FreeSpace, priority: Sequence[int], target: np.ndarray) -> None:
        self._space, self._priority, self._target = space, priority, target
        self.regions: dict[Choice, Region] = {}
        self._empty: set[Choice] = set()
        self._ends: dict[Choice, bool] = {}
        self._neighbours: dict[Choice, dict[Choice, Boundary]] = {}

    def neighbours(self, choice: Choice) -> dict[Choice, Boundary]:
        """Regions that differ in the side of one obstacle, in a fixed order, with the boundary in between."""
        if choice not in self._neighbours:
            found = {}
            for obstacle, side in enumerate(choice):
                for other in range(len(self._space.sides[obstacle])):
                    there = (*choice[:obstacle], other, *choice[obstacle + 1 :])
                    if other != side and self._exists(there):
                        a, b = self.regions[choice], self.regions[there]
                        boundary = _boundary(self._space, obstacle, a, b, self._priority)
                        if boundary is not None:
                            found[there] = boundary
            self._neighbours[choice] = dict(sorted(found.items()))
        return self._neighbours[choice]

    def ends(self, choice: Choice) -> bool:
        """Whether a region holds the target."""
        if choice not in self._ends:
            self._ends[choice] = holds(self._space, self.regions[choice], self._target)
        return self._ends[choice]

    def connects(self, starts: Iterable[Choice]) -> bool:
        """Whether any sequence of neighbours leads from one of the regions to one that holds the target."""
        seen = set(starts)
        waiting = list(seen)
        while waiting:
            choice = waiting.pop()
            if self.ends(choice):
                return True
            fresh = [there for there in self.neighbours(choice) if there not in seen]
            seen.update(fresh)
            waiting += fresh
        return False

    def _exists(self, choice: Choice) -> bool:
        if choice not in self.regions and choice not in self._empty:
            region = make_region(self._space, choice)
            if region is None:
                self._empty.add(choice)
            else:
                self.regions[choice] = region
        return choice in self.regions


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


def _boundary(space: FreeSpace, obstacle: int, a: Region, b: Region, priority: Sequence[int]) -> Boundary | None:
    """Where a path goes over from one region to another: on a face, out of the two sides of the obstacle, that passes
    through their intersection; None when there is none."""
    low, high = np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper)
    if (low > high).any():
        return None
    faces = [space.sides[obstacle][region.sides[obstacle]] for region in (a, b)]
    for pin in sorted((face for face in faces if any(face.normal)), key=lambda face: priority.index(face.axis)):
        box = _pinned_box(space, pin, b, a.polygon, low.copy(), high.copy())
        if box is not None:
            low, high = box
            return Boundary(pin, tuple(low.tolist()), tuple(high.tolist()))
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


def _returns(path: Sequence[Choice], choice: Choice) -> bool:
    """Whether a choice has a side of an obstacle that the path has been on and left."""
    for obstacle, side in enumerate(choice):
        if path[-1][obstacle] != side and any(before[obstacle] == side for before in path):
            return True
    return False
