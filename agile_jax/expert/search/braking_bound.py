"""A sharper lower bound on the duration of a route than the search's (minimum_time.py).

Where a path must be beyond a plane by a certain point, as low enough at the edge of a table, it can be no faster there
than it can brake within the bounds of the pose: the height at which a robot crouches under a table is a few
centimetres above the lowest that it can take. So the leg to the plane takes longer than with a free final velocity.
"""

import math

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.search.minimum_time import axis_time, least_motion, turning_legs
from agile_jax.expert.search.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.regions import FreeSpace

SHORTEST = 1e-9  # [s]


def tighten_bounds(problem: Problem, space: FreeSpace, route: Route) -> Route:
    """The route with bounds that know of the braking, none lower than before."""
    if not route.crossings:
        return route
    limits = list(zip(space.lower.tolist(), space.upper.tolist(), strict=True))
    forward, backward = [], []
    for i in range(len(limits)):
        intervals = [(low[i], high[i]) for low, high in route.boxes]
        forward.append(least_motion(float(problem.start[i]), intervals))
        backward.append(least_motion(float(problem.target[i]), intervals[::-1]))
    duration, settings = route.duration_bound, problem.settings
    for p in range(1, len(route.crossings) + 1):
        here, back = p + 1, len(route.crossings) + 2 - p
        arrival = max(_time(f[:here], i, limits[i], settings, problem.from_rest) for i, f in enumerate(forward))
        departure = max(_time(b[:back], i, limits[i], settings, True) for i, b in enumerate(backward))
        duration = max(duration, arrival + departure)
    # The objective's bound is T + c / T^3 with c from the effort, which increases with T.
    effort = (route.objective_bound - route.duration_bound) * route.duration_bound**3
    return route._replace(duration_bound=duration, objective_bound=duration + effort / max(duration, SHORTEST) ** 3)


def _time(
    points: list[float], axis: int, limits: tuple[float, float], settings: ExpertSettings, from_rest: bool
) -> float:
    """Least time on one axis through positions, after which it can still stop within its limits [s]."""
    legs = turning_legs(points)
    if not legs:
        return 0.0
    moves = np.diff(points)
    onward = moves[np.flatnonzero(moves)[-1]] > 0
    room = limits[1] - points[-1] if onward else points[-1] - limits[0]
    velocity, acceleration = settings.velocity[axis], settings.acceleration[axis]
    last = min(velocity, math.sqrt(2 * acceleration * max(room, 0.0)))
    earlier = 0.0
    if len(legs) > 1:
        earlier = axis_time(points[: _begin_of_last_leg(moves) + 1], velocity, acceleration, from_rest)
    return earlier + braked_time(legs[-1], last, velocity, acceleration, from_rest or len(legs) > 1)


def _begin_of_last_leg(moves: np.ndarray) -> int:
    """Index of the point at which the last monotone run begins."""
    sign = np.sign(moves[np.flatnonzero(moves)[-1]])
    return int(np.flatnonzero(moves * sign < 0)[-1]) + 1


def braked_time(distance: float, last: float, velocity: float, acceleration: float, from_rest: bool) -> float:
    """Least time [s] to cover a distance [m] and be no faster than `last` [m/s] at its end, from rest or else from any
    velocity."""
    if not from_rest:
        first = math.sqrt(last**2 + 2 * acceleration * distance)
        if first <= velocity:
            return (first - last) / acceleration
        braking = (velocity**2 - last**2) / (2 * acceleration)
        return (velocity - last) / acceleration + (distance - braking) / velocity
    peak = math.sqrt(acceleration * distance + last**2 / 2)
    if peak <= last:  # it never gets that fast
        return math.sqrt(2 * distance / acceleration)
    if peak <= velocity:
        return (2 * peak - last) / acceleration
    braking = (velocity**2 - last**2) / (2 * acceleration)
    cruising = distance - velocity**2 / (2 * acceleration) - braking
    return (2 * velocity - last) / acceleration + cruising / velocity
