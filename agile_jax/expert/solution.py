"""What the expert returns."""

from typing import NamedTuple

import numpy as np


class Trajectory(NamedTuple):
    """Piecewise-constant acceleration on a grid that may differ between the phases of a route. T intervals."""

    times: np.ndarray  # (T+1,) [s], from 0
    states: np.ndarray  # (T+1, 8) = [x y z yaw, rates] [m, rad, m/s, rad/s]
    controls: np.ndarray  # (T, 4) accelerations, constant over each interval [m/s^2, rad/s^2]


class Residuals(NamedTuple):
    """What the independent check found; zero or rounding error in an accepted trajectory."""

    dynamics_residual: float  # largest deviation of a state from the integrated controls [m, rad, m/s, rad/s]
    end_residual: float  # largest deviation from the initial and terminal conditions [m, rad, m/s, rad/s]
    bound_violation: float  # largest excess over a bound on pose, rate or acceleration
    clearance_violation: float  # max(0, margin - least clearance between and at the nodes) [m]
    min_clearance: float  # [m], infinity without obstacles


class ExpertSolution(NamedTuple):
    """The answer for one start. When `status` is "failed", trajectory is all zero and `cause` says why."""

    trajectory: Trajectory
    duration: float  # [s]
    lower_bound: float  # no trajectory can be shorter [s]
    gap: float  # duration / lower_bound - 1, 0 certifies the global optimum
    branch: str  # "direct", "under", "left", "right", "over", or several joined by "+"
    objective: float  # duration + effort_weight * effort
    status: str  # "solved" | "failed"
    cause: str  # "" when solved
    dynamics_residual: float
    end_residual: float
    bound_violation: float
    clearance_violation: float
    min_clearance: float
    routes: tuple[tuple[str, float], ...]  # (branch, objective) of every route that was solved
    solve_time_s: float
