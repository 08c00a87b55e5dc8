"""Closed forms for the double integrator with |v| <= V, |a| <= A: least times, and bounds for axis-aligned routes.

Per axis, distance d, ending at rest:

    from rest                  T = d/V + V/A      if d >= V^2/A      else 2 sqrt(d/A)
    from the best velocity     T = d/V + V/(2A)   if d >= V^2/(2A)   else sqrt(2 d/A)      (coast, then brake)

The axes are independent without obstacles, so the least time is the maximum over the axes, and with obstacles it
remains a lower bound. A route that forces an axis to turn (out sideways and back) splits that axis' motion into legs
with rest in between.
"""

import itertools
import math
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
    short = np.sqrt(4.0 * ramps * distance / acceleration)
    cruising = distance / velocity + ramps * velocity / acceleration
    return np.where(distance >= ramps * velocity**2 / acceleration, cruising, short)


def lower_bound(start: np.ndarray, target: np.ndarray, settings: ExpertSettings, initial_velocity: str) -> float:
    """Least duration that any trajectory from `start` to `target`, poses of shape (4,), can have [s]."""
    velocity, acceleration = np.array(settings.velocity), np.array(settings.acceleration)
    times = minimum_time(target - start, velocity, acceleration, initial_velocity)
    return float(times.max())


def turning_legs(points: Any) -> list[float]:
    """Lengths of the monotone runs of the positions, shape (n,), on one axis."""
    legs: list[float] = []
    direction = 0.0
    for a, b in itertools.pairwise(points):
        step = b - a
        if step == 0:
            continue
        if step * direction > 0:
            legs[-1] += abs(step)
        else:
            legs.append(abs(step))
            direction = step
    return legs


def axis_time(points: Any, axis: int, settings: ExpertSettings, first: str, last: str) -> float:
    """Least time on one axis through positions in order, at rest or with free velocity at the `first` and the `last`
    [s].

    Where the axis turns it is at rest, so each leg needs its least time.
    """
    legs = turning_legs(points)
    velocity, acceleration = settings.velocity[axis], settings.acceleration[axis]
    total = 0.0
    for j, leg in enumerate(legs):
        free = (j == 0 and first == "free") + (j == len(legs) - 1 and last == "free")
        total += leg / velocity if free == 2 else _leg_time(leg, velocity, acceleration, 1.0 - 0.5 * free)
    return total


def _leg_time(distance: float, velocity: float, acceleration: float, ramps: float) -> float:
    """`minimum_time` for numbers; `ramps` is 1 from rest to rest and 1/2 when one end is free (time may be
    reversed)."""
    if distance >= ramps * velocity**2 / acceleration:
        return distance / velocity + ramps * velocity / acceleration
    return math.sqrt(4.0 * ramps * distance / acceleration)


def laziest_points(start: np.ndarray, boxes: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Per axis the positions of the path that moves only when the next box (lower, upper) demands it. Shape (n + 1,
    4)."""
    points = [start]
    for low, high in boxes:
        points.append(np.clip(points[-1], low, high))
    return np.array(points)


def route_bounds(
    start: np.ndarray,
    boxes: Sequence[tuple[np.ndarray, np.ndarray]],
    target: np.ndarray,
    settings: ExpertSettings,
    initial_velocity: str,
) -> tuple[float, float]:
    """Lower bounds on the duration [s] and on the objective T + w E of every path that visits boxes in order.

    All axes are in box p at the same time, so the slowest axis up to it and the slowest axis after it add up. The
    effort of a leg is at least that of the unconstrained minimum, 12 d^2 / t^3 (3 d^2 / t^3 with free initial
    velocity); over the split of T into legs the least sum of c_j / t_j^3 is (sum c_j^(1/4))^4 / T^3.

    Args:
        start, target: poses, shape (4,).
        boxes: (lower, upper), each of shape (4,).
    """
    end = (target, target)
    axes = range(len(start))
    forward = laziest_points(start, [*boxes, end])
    duration = max(axis_time(forward[:, i], i, settings, initial_velocity, "rest") for i in axes)
    backward = laziest_points(target, boxes[::-1])
    for p in range(1, len(boxes) + 1):
        before = max(axis_time(forward[: p + 1, i], i, settings, initial_velocity, "free") for i in axes)
        after = max(axis_time(backward[: len(boxes) + 2 - p, i], i, settings, "rest", "free") for i in axes)
        duration = max(duration, before + after)

    effort = 0.0
    for i in axes:
        legs = turning_legs(forward[:, i])
        factors = [3.0 if j == 0 and initial_velocity == "free" else 12.0 for j in range(len(legs))]
        roots = sum(factor**0.25 * leg**0.5 for factor, leg in zip(factors, legs, strict=True))
        effort += roots**4 / settings.acceleration[i] ** 2
    weighted = settings.effort_weight * effort
    best = max(duration, (3 * weighted) ** 0.25, 1e-9)  # minimises T + w c / T^3 over T >= duration
    return duration, best + weighted / best**3
