"""Routes: sequences of regions from the start to the target, found in the order of their lower bound.

Consecutive regions differ in the side of one obstacle and intersect; a route ends in the first region that holds the
target and never comes back to one that holds the start (the rest of it would be a shorter route of its own). Between
two regions it goes over at a face (boundaries.py), or around an edge (edges.py); where there are several ways to do so,
each makes a route.
"""

import heapq
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.search.minimum_time import minimum_time, route_bounds
from agile_jax.expert.search.profile import Profile
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.boundaries import Boundary
from agile_jax.expert.space.faces import Face
from agile_jax.expert.space.graph import Graph
from agile_jax.expert.space.regions import Choice, FreeSpace, Region, regions_around

MAX_EXPANSIONS = 20_000
ROUNDING = 1e-6  # relative, of the time that routes may take
PATHS = 8  # that are followed through one region, the best ones: they multiply with the number of obstacles
PATIENCE = 50  # expansions without a route after which it is asked whether there is any


class Path(NamedTuple):
    """Regions one after the other, and which of the passages between each two."""

    choices: tuple[Choice, ...]
    ways: tuple[int, ...]


class Route(NamedTuple):
    """A sequence of P regions, one for each phase."""

    regions: tuple[Region, ...]
    boundaries: tuple[Boundary, ...]  # between phases p and p + 1, P - 1 of them
    detours: int  # passages that are not pinned on the slower horizontal axis
    duration_bound: float  # [s]
    objective_bound: float

    @property
    def pins(self) -> tuple[Face, ...]:
        """The faces that are the boundaries."""
        return tuple(boundary.pin for boundary in self.boundaries)


class RouteSearch:
    """Every route from `start` to `target`, poses of shape (4,), by increasing lower bound of its objective.

    A* search over paths in the graph of regions that never return to a side of an obstacle that they have left: the
    lower bound never falls when a route gets longer. A longer path waits with the bound of the shorter one, and gets
    its own when its turn comes.

    Args:
        profile: of the slowest axis, when only routes are wanted that may take its time; the bounds are then for
            motions of that duration.
        rounded: a route has a phase around each edge that it passes (edges.py).
    """

    def __init__(
        self,
        space: FreeSpace,
        start: np.ndarray,
        target: np.ndarray,
        settings: ExpertSettings,
        initial_velocity: str,
        profile: Profile | None = None,
        rounded: bool = False,
    ) -> None:
        # The axis that takes longest moves monotonically, and the fast path knows its motion; heights come last.
        bounds = np.array(settings.velocity), np.array(settings.acceleration)
        times = minimum_time(target - start, *bounds, initial_velocity)
        self._priority = (*np.argsort(-times[:2], kind="stable").tolist(), 2)
        self._graph = Graph(space, self._priority, start, target, rounded)
        self._starts = {region.sides: region for region in regions_around(space, start)}
        self._graph.regions.update(self._starts)
        self._problem = (settings, initial_velocity)
        self._ends = (start.tolist(), target.tolist())
        self._known = None if profile is None else (profile.axis, profile.effort, profile.duration)
        self._longest = math.inf if profile is None else profile.duration * (1 + ROUNDING)
        # (bound, number of regions, path, route): of equal bounds the simplest comes first. The route is None while the
        # bound is that of the path without its end.
        self._heap: list[tuple[float, int, Path, Route | None]] = [
            (0.0, 1, Path((choice,), ()), None) for choice in sorted(self._starts)
        ]
        self.expansions = 0
        self._followed: dict[Choice, int] = {}  # how often, by the region where a path ends
        self._found = False

    def next(self, most: float = math.inf) -> Route | None:
        """The next route; None when there is none whose bound is at most `most`, which must never grow."""
        heap = self._heap
        while heap and heap[0][0] <= most and self.expansions < MAX_EXPANSIONS:
            bound, size, path, route = heapq.heappop(heap)
            if route is None:
                route = self._evaluate(bound, path)
                if route.duration_bound > self._longest or route.objective_bound > most:
                    continue
                if heap and (route.objective_bound, size, path) > heap[0][:3]:
                    heapq.heappush(heap, (route.objective_bound, size, path, route))
                    continue
            last = path.choices[-1]
            if self._graph.ends(last):
                self._found = True
                return route
            self._followed[last] = followed = self._followed.get(last, 0) + 1
            if followed > PATHS:
                continue
            self.expansions += 1
            if self.expansions == PATIENCE and not self._found and not self._graph.connects(self._starts):
                heap.clear()
                return None
            for choice, passages in self._graph.neighbours(last).items():
                if choice not in self._starts and not _returns(path.choices, choice):
                    for way in range(len(passages)):
                        longer = Path((*path.choices, choice), (*path.ways, way))
                        heapq.heappush(heap, (route.objective_bound, size + 1, longer, None))
        return None

    def routes(self, most: Callable[[], float]) -> Iterator[Route]:
        """All that follow, each looked for when it is asked for, under the bound `most` at that time."""
        while (route := self.next(most())) is not None:
            yield route

    def _evaluate(self, bound: float, path: Path) -> Route:
        graph, (start, target) = self._graph, self._ends
        steps = zip(itertools.pairwise(path.choices), path.ways, strict=True)
        crossed = [graph.neighbours(a)[b][way] for (a, b), way in steps]
        boundaries = tuple(boundary for passage in crossed for boundary in passage.boundaries)
        boxes = [(boundary.lower, boundary.upper) for boundary in boundaries]
        duration, objective = route_bounds(start, boxes, target, *self._problem, self._known)
        detours = sum(passage.boundaries[0].pin.axis != self._priority[0] for passage in crossed)
        phases = [graph.regions[path.choices[0]]]
        for passage, choice in zip(crossed, path.choices[1:], strict=True):
            phases += [graph.regions[choice]] if passage.between is None else [passage.between, graph.regions[choice]]
        return Route(tuple(phases), boundaries, detours, duration, max(objective, bound))


def find_routes(
    space: FreeSpace,
    start: np.ndarray,
    target: np.ndarray,
    settings: ExpertSettings,
    initial_velocity: str,
    rounded: bool = False,
) -> Iterator[Route]:
    """Yield all routes in the order of `RouteSearch`."""
    return RouteSearch(space, start, target, settings, initial_velocity, rounded=rounded).routes(lambda: math.inf)


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


def _returns(path: Sequence[Choice], choice: Choice) -> bool:
    """Whether a choice has a side of an obstacle that the path has been on and left."""
    for obstacle, side in enumerate(choice):
        if path[-1][obstacle] != side and any(before[obstacle] == side for before in path):
            return True
    return False
