"""What the expert returns."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.expert.settings import ExpertSettings
from agile_jax.scene import POSE_SIZE


class Trajectory(NamedTuple):
    """A motion over T intervals, T + 1 nodes; the accelerations are constant over each interval or linear in it."""

    times: Float[np.ndarray, " nodes"]  # [s], from 0
    states: Float[np.ndarray, "nodes 8"]  # [x y z yaw, rates] [m, rad, m/s, rad/s]
    # Accelerations [m/s^2, rad/s^2]: (T, 4) constant over each interval, (T+1, 4) at the nodes and linear in between.
    controls: Float[np.ndarray, "_ 4"]


class Residuals(NamedTuple):
    """What the independent check found; zero or rounding error in an accepted trajectory."""

    dynamics_residual: float  # largest deviation of a state from the scheme's integrals [m, rad, m/s, rad/s]
    integration_defect: float  # the same from the exact integrals of the controls; not zero for trapezoidal
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
    branch: str  # "direct", "under", "left", "right", or several joined by "+"
    objective: float  # duration + effort_weight * effort
    status: Literal["solved", "failed"]
    cause: str  # "" when solved
    dynamics_residual: float
    integration_defect: float
    end_residual: float
    bound_violation: float
    clearance_violation: float
    min_clearance: float
    method: str  # "certified" (certified.py), or the attempt that solved it (retries.py)
    routes: tuple[tuple[str, float], ...]  # (branch, objective) of every route that was solved
    solve_time_s: float

    def __repr__(self) -> str:
        """One line: the trajectory has hundreds of numbers."""
        if self.status == "failed":
            return f"ExpertSolution(failed: {self.cause})"
        return f"ExpertSolution(solved: {self.duration:.3f} s, {self.branch}, by {self.method})"


CERTIFIED = "certified"  # the method of labels from the fast path
SHORTEST = 0.1  # [s] the least duration by which the gap is made relative


def solved(
    trajectory: Trajectory,
    residuals: Residuals,
    bound: float,
    branch: str,
    objective: float,
    method: str,
    routes: tuple[tuple[str, float], ...],
) -> ExpertSolution:
    """The solution with a verified trajectory; `bound` is the lower bound on its duration [s]."""
    duration = float(trajectory.times[-1])
    return ExpertSolution(
        trajectory=trajectory,
        duration=duration,
        lower_bound=bound,
        gap=(duration - bound) / max(bound, SHORTEST),
        branch=branch,
        objective=objective,
        status="solved",
        cause="",
        **residuals._asdict(),
        method=method,
        routes=routes,
        solve_time_s=0.0,
    )


def failed_solution(settings: ExpertSettings, bound: float, cause: str) -> ExpertSolution:
    """A solution without trajectory, that says why."""
    empty = Trajectory(
        np.zeros(settings.nodes + 1),
        np.zeros((settings.nodes + 1, 2 * POSE_SIZE)),
        np.zeros((settings.nodes + (settings.transcription != "zoh"), POSE_SIZE)),
    )
    zeros = Residuals(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return ExpertSolution(empty, 0.0, bound, 0.0, "", 0.0, "failed", cause, *zeros, "", (), 0.0)
