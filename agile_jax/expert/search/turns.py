"""On which side of its widest yaw a turning torso crosses a plane.

The footprint along a face's normal is a |cos| + b |sin| of the yaw, largest at the diagonals of the torso. A torso that
turns across a diagonal on its way can cross the face's plane before or after it: two local minima, of which a solver
finds the one nearer to its guess. So each route is split by the yaws at its boundaries, and every part is solved.
"""

import heapq
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from agile_jax.expert.search.braking_bound import sharpen
from agile_jax.expert.search.minimum_time import route_bounds
from agile_jax.expert.search.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.faces import Face, half_space_box
from agile_jax.expert.space.footprint import footprint_range
from agile_jax.expert.space.regions import FreeSpace

Interval = tuple[float, float]
NARROW = 0.01  # [rad] a turn that ends this near to a diagonal does not cross it


def split_turns(
    space: FreeSpace,
    routes: Iterator[Route],
    start: np.ndarray,
    target: np.ndarray,
    settings: ExpertSettings,
    initial_velocity: str,
) -> Iterator[Route]:
    """Yield the parts of all routes by increasing lower bound of their objective, as `RouteSearch` does."""
    waiting: list[tuple[float, int, Route]] = []
    count = itertools.count()
    for route in routes:
        while waiting and waiting[0][0] <= route.objective_bound:
            yield heapq.heappop(waiting)[-1]
        for part in _parts(space, route, start, target, settings, initial_velocity):
            part = sharpen(space, part, start, target, settings, initial_velocity)
            heapq.heappush(waiting, (part.objective_bound, next(count), part))
        while waiting and waiting[0][0] <= route.objective_bound:
            yield heapq.heappop(waiting)[-1]
    while waiting:
        yield heapq.heappop(waiting)[-1]


def _parts(
    space: FreeSpace,
    route: Route,
    start: np.ndarray,
    target: np.ndarray,
    settings: ExpertSettings,
    initial_velocity: str,
) -> Iterator[Route]:
    begin, end = float(start[3]), float(target[3])
    choices = [_intervals(space, pin, min(begin, end), max(begin, end)) for pin in route.pins]
    if all(len(choice) == 1 for choice in choices):
        yield route
        return
    for chosen in itertools.product(*choices):
        if not _turns_on(route.pins, chosen, end > begin):
            continue
        boundaries = []
        for boundary, (low, high) in zip(route.boundaries, chosen, strict=True):
            lower = np.array([*boundary.lower[:3], max(boundary.lower[3], low)])
            upper = np.array([*boundary.upper[:3], min(boundary.upper[3], high)])
            lower, upper = _reached(space, boundary.pin, lower, upper)
            boundaries.append(boundary._replace(lower=tuple(lower.tolist()), upper=tuple(upper.tolist())))
        boxes = [(boundary.lower, boundary.upper) for boundary in boundaries]
        bounds = route_bounds(start.tolist(), boxes, target.tolist(), settings, initial_velocity)
        yield route._replace(boundaries=tuple(boundaries), duration_bound=bounds[0], objective_bound=bounds[1])


def _intervals(space: FreeSpace, pin: Face, low: float, high: float) -> list[Interval]:
    """The parts of a turn between the yaws at which the torso is widest along a pin's normal."""
    if not space.exact or not pin.normal[:2].any():
        return [(-np.inf, np.inf)]
    ahead = np.arctan2(pin.normal[1], pin.normal[0])
    diagonal = np.arctan2(space.half_size[1], space.half_size[0])
    widest = [ahead + sign * diagonal + turn * np.pi for sign in (-1, 1) for turn in range(-3, 4)]
    cuts = sorted(float(yaw) for yaw in widest if low + NARROW < yaw < high - NARROW)
    return list(itertools.pairwise([-np.inf, *cuts, np.inf]))


def _reached(space: FreeSpace, pin: Face, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of a box of poses lies where the torso, at its yaws, can touch a pin's face."""
    if pin.normal[:2].any():
        least, most = footprint_range(space.half_size, pin.normal, (lower[3], upper[3]))
        offset = pin.value - pin.least
        lower, upper = half_space_box(pin.normal, offset + least, lower, upper)
        lower, upper = half_space_box(-pin.normal, -offset - most, lower, upper)
    return np.minimum(lower, upper), upper


def _turns_on(pins: Sequence[Face], chosen: Sequence[Interval], increasing: bool) -> bool:
    """Whether a turn that does not go back can have these yaws, the same around one edge."""
    for (a, b), (before, after) in zip(itertools.pairwise(pins), itertools.pairwise(chosen), strict=True):
        if np.array_equal(a.normal, b.normal) and before != after:
            return False
        if (after[1] <= before[0]) if increasing else (after[0] >= before[1]):
            return False
    return True
