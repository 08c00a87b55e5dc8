"""On which side of its widest yaw a turning torso crosses a plane.

The footprint along a face's normal is a |cos| + b |sin| of the yaw, largest at the diagonals of the torso. A torso that
turns across a diagonal on its way can cross the face's plane before or after it: two local minima, of which a solver
finds the one nearer to its guess. So each route is split by the yaws at its crossings, and every part is solved.
"""

import heapq
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.search.braking_bound import tighten_bounds
from agile_jax.expert.search.minimum_time import route_bounds
from agile_jax.expert.search.routes import Route, phase_speeds
from agile_jax.expert.space.cells import Face, half_space_box
from agile_jax.expert.space.footprint import footprint_range
from agile_jax.expert.space.regions import FreeSpace

Interval = tuple[float, float]
NARROW = 0.01  # [rad] a turn that ends this near to a diagonal does not cross it


def split_turns(problem: Problem, space: FreeSpace, routes: Iterator[Route]) -> Iterator[Route]:
    """Yield the parts of all routes by increasing lower bound of their objective, as `RouteSearch` does."""
    waiting: list[tuple[float, int, Route]] = []
    count = itertools.count()
    for route in routes:
        while waiting and waiting[0][0] <= route.objective_bound:
            yield heapq.heappop(waiting)[-1]
        for part in _parts(problem, space, route):
            part = tighten_bounds(problem, space, part)
            heapq.heappush(waiting, (part.objective_bound, next(count), part))
        while waiting and waiting[0][0] <= route.objective_bound:
            yield heapq.heappop(waiting)[-1]
    while waiting:
        yield heapq.heappop(waiting)[-1]


def _parts(problem: Problem, space: FreeSpace, route: Route) -> Iterator[Route]:
    begin, end = float(problem.start[3]), float(problem.target[3])
    choices = [_intervals(space, face, min(begin, end), max(begin, end)) for face in route.crossed]
    if all(len(choice) == 1 for choice in choices):
        yield route
        return
    for chosen in itertools.product(*choices):
        if not _turns_on(route.crossed, chosen, end > begin):
            continue
        crossings = []
        for crossing, (low, high) in zip(route.crossings, chosen, strict=True):
            lower = np.array([*crossing.lower[:3], max(crossing.lower[3], low)])
            upper = np.array([*crossing.upper[:3], min(crossing.upper[3], high)])
            lower, upper = _reached(space, crossing.face, lower, upper)
            crossings.append(crossing._replace(lower=tuple(lower.tolist()), upper=tuple(upper.tolist())))
        part = route._replace(crossings=tuple(crossings))
        bounds = route_bounds(problem, part.boxes, speeds=phase_speeds(problem, part.regions))
        yield part._replace(duration_bound=bounds[0], objective_bound=bounds[1])


def _intervals(space: FreeSpace, face: Face, low: float, high: float) -> list[Interval]:
    """The parts of a turn between the yaws at which the torso is widest along a face's normal."""
    if not space.exact or not face.normal[:2].any():
        return [(-np.inf, np.inf)]
    ahead = np.arctan2(face.normal[1], face.normal[0])
    diagonal = np.arctan2(space.half_size[1], space.half_size[0])
    widest = [ahead + sign * diagonal + turn * np.pi for sign in (-1, 1) for turn in range(-3, 4)]
    cuts = sorted(float(yaw) for yaw in widest if low + NARROW < yaw < high - NARROW)
    return list(itertools.pairwise([-np.inf, *cuts, np.inf]))


def _reached(space: FreeSpace, face: Face, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of a box of poses lies where the torso, at its yaws, can touch a face's face."""
    if face.normal[:2].any():
        least, most = footprint_range(space.half_size, face.normal, (lower[3], upper[3]))
        offset = face.value - face.least
        lower, upper = half_space_box(face.normal, offset + least, lower, upper)
        lower, upper = half_space_box(-face.normal, -offset - most, lower, upper)
    return np.minimum(lower, upper), upper


def _turns_on(faces: Sequence[Face], chosen: Sequence[Interval], increasing: bool) -> bool:
    """Whether a turn that does not go back can have these yaws, the same around one edge."""
    for (a, b), (before, after) in zip(itertools.pairwise(faces), itertools.pairwise(chosen), strict=True):
        if np.array_equal(a.normal, b.normal) and before != after:
            return False
        if (after[1] <= before[0]) if increasing else (after[0] >= before[1]):
            return False
    return True
