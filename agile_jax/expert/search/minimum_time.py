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
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.expert.problem import Problem
from agile_jax.expert.settings import ExpertSettings, InitialVelocity
from agile_jax.scene import PLANAR

Box = tuple[Sequence[float], Sequence[float]]  # (lower, upper) of poses, each (4,)
Numbers = Float[np.ndarray, "*#shape"] | float


class KnownAxis(NamedTuple):
    """An axis whose motion is known."""

    axis: int
    effort: float  # integral of (u / a)^2 [s]
    duration: float  # [s]


def minimum_time(
    distance: Numbers, velocity: Numbers, acceleration: Numbers, initial_velocity: InitialVelocity = "rest"
) -> Float[np.ndarray, "*shape"]:
    """Least time to cover `distance` and stop there [s].

    Args:
        distance: target - start per axis [m or rad].
        velocity, acceleration: bounds [m/s, m/s^2 or rad/s, rad/s^2].
        initial_velocity: "rest", or "free" for the best initial velocity within its bound.
    """
    distance = np.abs(distance)
    ramps = 1.0 if initial_velocity == "rest" else 0.5  # ramps between rest and full speed, in units of V/A
    short = np.sqrt(4.0 * ramps * distance / acceleration)
    cruising = distance / velocity + ramps * velocity / acceleration
    return np.where(distance >= ramps * velocity**2 / acceleration, cruising, short)


def lower_bound(
    start: Float[np.ndarray, "4"],
    target: Float[np.ndarray, "4"],
    settings: ExpertSettings,
    initial_velocity: InitialVelocity,
) -> float:
    """Least duration that any trajectory between two poses [m, rad] can have [s]."""
    return float(minimum_time(target - start, *settings.limits, initial_velocity).max())


def turning_legs(points: Sequence[float]) -> list[float]:
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


def leg_time(distance: float, velocity: float, acceleration: float, ramps: float) -> float:
    """`minimum_time` for numbers; `ramps` is 1 from rest to rest, 1/2 when one end is free (time may be reversed), 0
    when both are."""
    if distance >= ramps * velocity**2 / acceleration:
        return distance / velocity + ramps * velocity / acceleration
    return math.sqrt(4.0 * ramps * distance / acceleration)


def passing_times(points: Sequence[float], velocity: float, acceleration: float, from_rest: bool) -> list[float]:
    """Least times in which one axis, at rest or with free velocity at the first of its positions, passes the second,
    the third, ... (n - 1,) [s].

    Where the axis turns it is at rest, so each leg needs its least time.
    """
    begun = 1.0 if from_rest else 0.5  # ramps of the present leg if it ended at rest
    past = leg = direction = 0.0  # time of the legs before, length and direction of the present one
    times = []
    for a, b in itertools.pairwise(points):
        step = b - a
        if step * direction < 0:
            past += leg_time(leg, velocity, acceleration, begun)
            begun, leg = 1.0, 0.0
        if step != 0:
            direction = step
        leg += abs(step)
        times.append(past + leg_time(leg, velocity, acceleration, begun - 0.5))
    return times


def axis_time(points: Sequence[float], velocity: float, acceleration: float, from_rest: bool) -> float:
    """Least time of one axis through positions in order, at rest or with free velocity at the first, at rest at the
    last [s]."""
    legs = turning_legs(points)
    ramps = [0.5 if j == 0 and not from_rest else 1.0 for j in range(len(legs))]
    return sum((leg_time(leg, velocity, acceleration, ramp) for leg, ramp in zip(legs, ramps, strict=True)), 0.0)


def least_motion(start: float, boxes: Sequence[tuple[float, float]]) -> list[float]:
    """The positions of an axis that moves only when the next interval (lower, upper) demands it, (n + 1,)."""
    points = [start]
    for low, high in boxes:
        points.append(min(max(points[-1], low), high))
    return points


def crossing_time_bounds(
    problem: Problem, boxes: Sequence[Box], speeds: Sequence[float] = ()
) -> tuple[list[float], list[float]]:
    """Lower bounds on the times from the start to each of the boxes that are visited in order, and from each of them
    to rest at the target [s].

    The slowest axis decides, all the way or from one box to the next at full speed.

    Args:
        problem: start, target and bounds count.
        boxes: of poses.
        speeds: top speeds of the horizontal axes before, between and after the boxes [m/s]; none where they do not
            matter.
    """
    before, after = [0.0] * len(boxes), [0.0] * len(boxes)
    if not boxes:
        return before, after
    start, target, settings = problem.start.tolist(), problem.target.tolist(), problem.settings
    apart = [0.0] * (len(boxes) + 1)  # to each box, and the target, from what is before it [s]
    for i, (velocity, acceleration) in enumerate(zip(settings.velocity, settings.acceleration, strict=True)):
        intervals = [(low[i], high[i]) for low, high in boxes]
        forward, backward = least_motion(start[i], intervals), least_motion(target[i], intervals[::-1])
        passed = passing_times(forward, velocity, acceleration, problem.from_rest)
        left = passing_times(backward, velocity, acceleration, True)[::-1]
        before = [max(pair) for pair in zip(before, passed, strict=True)]
        after = [max(pair) for pair in zip(after, left, strict=True)]
        stops = [(start[i], start[i]), *intervals, (target[i], target[i])]
        for p, ((low, high), (there_low, there_high)) in enumerate(itertools.pairwise(stops)):
            speed = min(velocity, speeds[p]) if speeds and i in PLANAR else velocity
            apart[p] = max(apart[p], (there_low - high) / speed, (low - there_high) / speed)
    for p in range(len(boxes)):
        before[p] = max(before[p], (before[p - 1] if p else 0.0) + apart[p])
        back = len(boxes) - 1 - p
        after[back] = max(after[back], (after[back + 1] if p else 0.0) + apart[back + 1])
    return before, after


def route_bounds(
    problem: Problem, boxes: Sequence[Box], known: KnownAxis | None = None, speeds: Sequence[float] = ()
) -> tuple[float, float]:
    """Lower bounds on the duration [s] and on the objective T + w E of every path that visits boxes in order.

    All axes are in box p at the same time, so the slowest axis up to it and the slowest axis after it add up. The
    effort of a leg is at least that of the unconstrained minimum, 12 d^2 / t^3 (3 d^2 / t^3 with free initial
    velocity); over the split of T into legs the least sum of c_j / t_j^3 is (sum c_j^(1/4))^4 / T^3.

    Args:
        problem: start, target and bounds count.
        boxes: of poses. Plain numbers are faster than arrays.
        known: the bound of the objective is then for paths of that duration.
        speeds: of `crossing_time_bounds`.
    """
    start, target, settings = problem.start.tolist(), problem.target.tolist(), problem.settings
    before, after = crossing_time_bounds(problem, boxes, speeds)
    duration, effort = max((a + b for a, b in zip(before, after, strict=True)), default=0.0), 0.0
    for i, (velocity, acceleration) in enumerate(zip(settings.velocity, settings.acceleration, strict=True)):
        intervals = [(low[i], high[i]) for low, high in boxes]
        forward = [*least_motion(start[i], intervals), target[i]]
        duration = max(duration, axis_time(forward, velocity, acceleration, problem.from_rest))
        if known is not None and i == known.axis:
            continue
        roots = 0.0
        for j, leg in enumerate(turning_legs(forward)):
            roots += (3.0 if j == 0 and not problem.from_rest else 12.0) ** 0.25 * leg**0.5
        effort += roots**4 / acceleration**2
    if known is not None:
        objective = settings.effort_weight * (known.effort + effort / max(known.duration, 1e-9) ** 3)
        return duration, known.duration + objective
    weighted = settings.effort_weight * effort
    best = max(duration, (3 * weighted) ** 0.25, 1e-9)  # minimises T + w c / T^3 over T >= duration
    return duration, best + weighted / best**3
