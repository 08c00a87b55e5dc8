"""The slowest axis at the analytic least time, and time grids whose nodes fall on its switches.

At the lower bound T the slowest axis has no freedom left: full acceleration, coasting at the peak speed, full braking
(with free initial velocity: coasting, braking). Piecewise-constant acceleration represents this exactly when the
switches are nodes.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.search.minimum_time import minimum_time

SHORTEST = 1e-9  # [s] switches nearer to each other are one


class Profile(NamedTuple):
    """Least-time motion of the slowest axis, s(t) = start + sign * (distance covered by t)."""

    axis: int
    start: float
    sign: float
    distance: float
    peak: float  # largest speed [m/s or rad/s]
    acceleration: float
    ramp: float  # when the acceleration ends, 0 with free initial velocity [s]
    brake: float  # when the braking begins [s]
    duration: float  # [s]

    @property
    def switches(self) -> tuple[float, float]:
        """When the acceleration changes [s]."""
        return self.ramp, self.brake

    @property
    def effort(self) -> float:
        """Integral of (u / a)^2 [s]."""
        return self.ramp + self.duration - self.brake

    def time_at(self, position: float) -> float:
        """When the axis passes a position; positions before the start or beyond the target count as these [s]."""
        covered = min(max(self.sign * (position - self.start), 0.0), self.distance)
        ramped = self.acceleration * self.ramp**2 / 2
        left = self.distance - covered
        if covered < ramped:
            return math.sqrt(2 * covered / self.acceleration)
        if left < self.peak**2 / self.acceleration / 2:
            return self.duration - math.sqrt(2 * left / self.acceleration)
        return min(self.ramp + (covered - ramped) / self.peak, self.duration) if self.peak > 0 else 0.0

    def states(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (T+1,), rates (T+1,) and controls (T,) on a grid, shape (T+1,), that holds the switches."""
        a = self.acceleration
        middle = (times[:-1] + times[1:]) / 2
        controls = self.sign * a * ((middle < self.ramp).astype(float) - (middle > self.brake))
        left = np.maximum(self.duration - times, 0.0)
        ramped = a * self.ramp**2 / 2
        covered = np.where(
            times < self.ramp,
            a * times**2 / 2,
            np.where(times > self.brake, self.distance - a * left**2 / 2, ramped + (times - self.ramp) * self.peak),
        )
        speed = np.minimum(np.minimum(a * left, self.peak), a * times if self.ramp > 0 else np.inf)
        return self.start + self.sign * covered, self.sign * speed, controls


def slowest_axis(problem: Problem) -> Profile:
    """The least-time motion of the axis that determines the lower bound."""
    start, settings, rest = problem.start, problem.settings, problem.from_rest
    moves = problem.target - start
    times = minimum_time(moves, *settings.limits, problem.initial_velocity)
    axis = int(np.argmax(times))
    distance, velocity = abs(float(moves[axis])), settings.velocity[axis]
    acceleration, duration = settings.acceleration[axis], float(times[axis])
    peak = min(velocity, math.sqrt((1.0 if rest else 2.0) * acceleration * distance))
    ramp = peak / acceleration
    return Profile(
        axis=axis,
        start=float(start[axis]),
        sign=math.copysign(1.0, moves[axis]),
        distance=distance,
        peak=peak,
        acceleration=acceleration,
        ramp=ramp if rest else 0.0,
        brake=max(duration - ramp, ramp if rest else 0.0),
        duration=duration,
    )


def make_grid(
    breaks: Sequence[float], duration: float, intervals: int, shortest: float = SHORTEST
) -> np.ndarray | None:
    """Times (intervals + 1,) from 0 to `duration` [s] that hold all breaks and are even in between.

    Breaks nearer than `shortest` [s] to the one before or to the end are left out. None when there are more breaks
    than intervals.
    """
    points = [0.0]
    for point in sorted(breaks):
        if points[-1] + shortest < point < duration - shortest:
            points.append(point)
    points.append(duration)
    lengths = [b - a for a, b in itertools.pairwise(points)]
    spare = intervals - len(lengths)
    if spare < 0:
        return None
    # Each stretch has one interval; the others go where the steps would be longest.
    wanted = [max(length / duration * intervals - 1, 0.0) for length in lengths]
    share = spare / max(sum(wanted), 1e-12)
    counts = [1 + math.floor(more * share) for more in wanted]
    for _ in range(intervals - sum(counts)):
        steps = [length / count for length, count in zip(lengths, counts, strict=True)]
        counts[steps.index(max(steps))] += 1
    return np.interp(np.arange(intervals + 1), [0, *itertools.accumulate(counts)], points)
