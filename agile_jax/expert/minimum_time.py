"""Closed forms for the double integrator with |v| <= V, |a| <= A: least times, and bounds for axis-aligned routes.

Per axis, distance d, ending at rest:

    from rest                  T = d/V + V/A      if d >= V^2/A      else 2 sqrt(d/A)
    from the best velocity     T = d/V + V/(2A)   if d >= V^2/(2A)   else sqrt(2 d/A)      (coast, then brake)

The axes are independent without obstacles, so the least time is the maximum over the axes, and with obstacles it remains a lower
bound. A route that forces an axis to turn (out sideways and back) splits that axis' motion into legs with rest in between.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from agile_jax.expert.settings import ExpertSettings


def minimum_time(distance: Any, velocity: Any, acceleration: Any, initial_velocity: str = "rest") -> Any:
    """Least time to cover `distance` and stop there [s].

    Args:
        distance: |target - start| per axis, shape (...) [m or rad].
        velocity, acceleration: bounds, broadcast against `distance`.
        initial_velocity: "rest", or "free" for the best initial velocity within its bound.

    Returns:
        Shape (...).
    """
    distance = np.abs(distance)
    ramps = 1.0 if initial_velocity == "rest" else 0.5  # ramps between rest and full speed, in units of V/A
    short = np.sqrt((4.0 if initial_velocity == "rest" else 2.0) * distance / acceleration)
    cruising = distance / velocity + ramps * velocity / acceleration
    return np.where(distance >= ramps * velocity**2 / acceleration, cruising, short)


def lower_bound(start: np.ndarray, target: np.ndarray, settings: ExpertSettings, initial_velocity: str) -> float:
    """Least duration that any trajectory from `start` to `target`, poses of shape (4,), can have [s]."""
    velocity, acceleration = np.array(settings.velocity), np.array(settings.acceleration)
    times = minimum_time(target - start, velocity, acceleration, initial_velocity)
    return float(times.max())


def turning_legs(points: Sequence[float]) -> list[float]:
    """Lengths of the monotone runs of a sequence of positions on one axis."""
    legs: list[float] = []
    direction = 0.0
    for a, b in zip(points, points[1:], strict=False):
        step = b - a
        if step == 0:
            continue
        if step * direction > 0:
            legs[-1] += abs(step)
        else:
            legs.append(abs(step))
            direction = step
    return legs


def route_bounds(waypoints: np.ndarray, settings: ExpertSettings, initial_velocity: str) -> tuple[float, float]:
    """Lower bounds on the duration [s] and on the objective T + w E of every path through a sequence of boxes.

    Each axis moves as little as the boxes allow; `waypoints` are these laziest positions. Where it turns it is at rest, so each leg needs
    its least time. Its effort is at least that of the unconstrained minimum, 12 d^2 / t^3 (3 d^2 / t^3 with free initial velocity);
    over the split of T into legs the least sum of c_j / t_j^3 is (sum c_j^(1/4))^4 / T^3.

    Args:
        waypoints: shape (n, 4), from the start to the target.
    """
    duration = effort = 0.0
    for axis in range(waypoints.shape[1]):
        legs = turning_legs(list(waypoints[:, axis]))
        time = root = 0.0
        for j, leg in enumerate(legs):
            condition = initial_velocity if j == 0 else "rest"
            time += float(minimum_time(leg, settings.velocity[axis], settings.acceleration[axis], condition))
            root += (12.0 if condition == "rest" else 3.0) ** 0.25 * leg**0.5
        duration = max(duration, time)
        effort += root**4 / settings.acceleration[axis] ** 2
    weighted = settings.effort_weight * effort
    best = max(duration, (3 * weighted) ** 0.25, 1e-9)  # minimises T + w c / T^3 over T >= duration
    return duration, best + weighted / best**3
