"""Routes: sequences of regions from the start to the target, found in the order of their lower bound.

Consecutive regions differ in the cell of one obstacle and intersect; a route ends in the first region that holds the
target and never comes back to one that holds the start (the rest of it would be a shorter route of its own). It
crosses from one region to the next at a face (crossings.py), or around an edge (edges.py); where there are several ways
to do so, each makes a route.
"""

import heapq
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.search.minimum_time import KnownAxis, minimum_time, route_bounds
from agile_jax.expert.search.profile import Profile
from agile_jax.expert.space.cells import Face
from agile_jax.expert.space.crossings import Crossing
from agile_jax.expert.space.graph import Graph
from agile_jax.expert.space.regions import Choice, FreeSpace, Region, regions_around
from agile_jax.scene import top_speed

SLOWEST = 1e-6  # [m/s] keeps times finite
MAX_EXPANSIONS = 20_000
ROUNDING = 1e-6  # relative, of the time that routes may take
PATHS_PER_REGION = 8  # that are followed, the best ones: they multiply with the number of obstacles
CONNECTIVITY_CHECK = 50  # expansions without a route after which it is asked whether there is any


class RegionPath(NamedTuple):
    """Regions one after the other, and which of the passages between each two."""

    choices: tuple[Choice, ...]
    passages: tuple[int, ...]


class Route(NamedTuple):
    """A sequence of P regions, one for each phase."""

    regions: tuple[Region, ...]
    crossings: tuple[Crossing, ...]  # from phase p to p + 1, P - 1 of them
    detours: int  # passages that do not cross on the slower horizontal axis
    duration_bound: float  # [s]
    objective_bound: float

    @property
    def crossed(self) -> tuple[Face, ...]:
        """The faces at which it crosses."""
        return tuple(crossing.face for crossing in self.crossings)

    @property
    def boxes(self) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
        """The boxes of poses (lower, upper) around its crossings."""
        return [(crossing.lower, crossing.upper) for crossing in self.crossings]


class RouteSearch:
    """Every route of a problem, by increasing lower bound of its objective.

    A* search over paths in the graph of regions that never return to a cell of an obstacle that they have left: the
    lower bound never falls when a route gets longer. A longer path waits with the bound of the shorter one, and gets
    its own when its turn comes.

    Args:
        profile: of the slowest axis, when only routes are wanted that may take its time; the bounds are then for
            motions of that duration.
        rounded: a route has a phase around each edge that it passes (edges.py).
    """

    def __init__(
        self, space: FreeSpace, problem: Problem, profile: Profile | None = None, rounded: bool = False
    ) -> None:
        # The axis that takes longest moves monotonically, and the fast path knows its motion; heights come last.
        times = minimum_time(problem.target - problem.start, *problem.settings.limits, problem.initial_velocity)
        self._priority = (*np.argsort(-times[:2], kind="stable").tolist(), 2)
        self._graph = Graph(space, self._priority, problem, rounded)
        self._starts = {region.cells: region for region in regions_around(space, problem.start)}
        self._graph.regions.update(self._starts)
        self._problem = problem
        self._known = None if profile is None else KnownAxis(profile.axis, profile.effort, profile.duration)
        self._longest = math.inf if profile is None else profile.duration * (1 + ROUNDING)
        # (bound, number of regions, path, route): of equal bounds the simplest comes first. The route is None while the
        # bound is that of the path without its end.
        self._heap: list[tuple[float, int, RegionPath, Route | None]] = [
            (0.0, 1, RegionPath((choice,), ()), None) for choice in sorted(self._starts)
        ]
        self.expansions = 0
        self._followed: dict[Choice, int] = {}  # how often, by the region where a path ends
        self._found = False

    def next(self, limit: float = math.inf) -> Route | None:
        """The next route; None when there is none whose bound is at most `limit`, which must never grow."""
        heap = self._heap
        while heap and heap[0][0] <= limit and self.expansions < MAX_EXPANSIONS:
            bound, size, path, route = heapq.heappop(heap)
            if route is None:
                route = self._evaluate(bound, path)
                if route.duration_bound > self._longest or route.objective_bound > limit:
                    continue
                if heap and (route.objective_bound, size, path) > heap[0][:3]:
                    heapq.heappush(heap, (route.objective_bound, size, path, route))
                    continue
            last = path.choices[-1]
            if self._graph.holds_target(last):
                self._found = True
                return route
            self._followed[last] = followed = self._followed.get(last, 0) + 1
            if followed > PATHS_PER_REGION:
                continue
            self.expansions += 1
            if self.expansions == CONNECTIVITY_CHECK and not self._found and not self._graph.connects(self._starts):
                heap.clear()
                return None
            for choice, passages in self._graph.neighbours(last).items():
                if choice not in self._starts and not _returns(path.choices, choice):
                    for passage in range(len(passages)):
                        longer = RegionPath((*path.choices, choice), (*path.passages, passage))
                        heapq.heappush(heap, (route.objective_bound, size + 1, longer, None))
        return None

    def routes(self, limit: Callable[[], float] = lambda: math.inf) -> Iterator[Route]:
        """All that follow, each looked for when it is asked for, under the `limit` of bounds at that time."""
        while (route := self.next(limit())) is not None:
            yield route

    def _evaluate(self, bound: float, path: RegionPath) -> Route:
        graph = self._graph
        steps = zip(itertools.pairwise(path.choices), path.passages, strict=True)
        passed = [graph.neighbours(a)[b][passage] for (a, b), passage in steps]
        detours = sum(passage.crossings[0].face.axis != self._priority[0] for passage in passed)
        phases = [graph.regions[path.choices[0]]]
        for passage, choice in zip(passed, path.choices[1:], strict=True):
            phases += [graph.regions[choice]] if passage.between is None else [passage.between, graph.regions[choice]]
        crossings = tuple(crossing for passage in passed for crossing in passage.crossings)
        route = Route(tuple(phases), crossings, detours, 0.0, 0.0)
        duration, objective = route_bounds(
            self._problem, route.boxes, self._known, phase_speeds(self._problem, route.regions)
        )
        return route._replace(duration_bound=duration, objective_bound=max(objective, bound))


def phase_speeds(problem: Problem, regions: Sequence[Region]) -> list[float]:
    """How fast the horizontal axes can be in each region at its greatest height [m/s]; empty where that is no bound."""
    if len(problem.scene.speed_heights) == 0:
        return []
    return [max(float(top_speed(problem.scene, region.upper[2])), SLOWEST) for region in regions]


def waypoints(route: Route, problem: Problem) -> np.ndarray:
    """Start, one point on each crossing, target, shape (P + 1, 4): the initial guess, a string pulled tight by fixed
    sweeps."""
    boxes, start = route.boxes, problem.start
    points = [start, *(np.clip(start, low, high) for low, high in boxes), problem.target]
    for _ in range(30):
        for p, (low, high) in enumerate(boxes, start=1):
            before, after = points[p - 1], points[p + 1]
            ahead = np.linalg.norm(points[p] - before) + 1e-3
            behind = np.linalg.norm(after - points[p]) + 1e-3
            points[p] = np.clip((before * behind + after * ahead) / (ahead + behind), low, high)
    return np.array(points)


def _returns(path: Sequence[Choice], choice: Choice) -> bool:
    """Whether a choice has a cell of an obstacle that the path has been in and left."""
    for obstacle, cell in enumerate(choice):
        if path[-1][obstacle] != cell and any(before[obstacle] == cell for before in path):
            return True
    return False
