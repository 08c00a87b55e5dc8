"""Least effort of one axis at a fixed time: a convex quadratic program.

    minimise    sum_k h_k (u_k / a)^2
    subject to  p(0) = start,  p'(0) = 0 or free,  p(T) = target,  p'(T) = 0,  |p'_k| <= v,  |u_k| <= a,
                lower_k <= p_k <= upper_k

u is constant over each interval. In y_k = u_k sqrt(h_k) / a the objective is |y|^2, and rates and positions are linear
in y; free initial velocity is eliminated by the final rest. The minimum is unique because the objective is strictly
convex. Without active bounds it is the least-norm solution of the end conditions; otherwise DAQP, an active-set
solver whose answer is exact up to rounding.
"""

from typing import Any, NamedTuple

import numpy as np

SLACK = 1e-9  # in units of acceleration [s^2]; far below the verifier's tolerance


class AxisGrid(NamedTuple):
    """Linear maps from y to the motion on one grid of N intervals, for an axis with unit acceleration."""

    steps: np.ndarray  # (N,) [s]
    roots: np.ndarray  # (N,) sqrt(steps)
    rates: np.ndarray  # (N+1, N)
    positions: np.ndarray  # (N+1, N)
    ends: np.ndarray  # (1 or 2, N) rows that the end conditions fix: final position, and final rate when from rest
    inverse: np.ndarray  # (N, 1 or 2) least-norm right inverse of `ends`


def make_axis_grid(times: np.ndarray, initial_velocity: str) -> AxisGrid:
    """The maps on a grid of times, shape (N+1,) [s]."""
    steps = np.diff(times)
    roots = np.sqrt(steps)
    earlier = np.tril(np.ones((len(times), len(steps))), -1)
    rates = earlier * roots
    positions = rates * (times[:, None] - (times[:-1] + times[1:]) / 2)
    if initial_velocity == "free":  # p'(0) = - sum h u
        rates = rates - roots
        positions = positions - times[:, None] * roots
        ends = positions[-1:]
    else:
        ends = np.stack([positions[-1], rates[-1]])
    return AxisGrid(steps, roots, rates, positions, ends, ends.T @ np.linalg.inv(ends @ ends.T))


class AxisSolver:
    """DAQP for grids of one number of intervals, built once. Holds no state between calls."""

    def __init__(self, intervals: int, initial_velocity: str) -> None:
        import casadi

        ca: Any = casadi  # its type stubs do not know the buffer protocol
        self._fixed = 1 if initial_velocity == "free" else 2
        self._rows = self._fixed + 2 * intervals
        shapes = {"h": ca.Sparsity.diag(intervals), "a": ca.Sparsity.dense(self._rows, intervals)}
        options = {"error_on_fail": False, "daqp": {"primal_tol": SLACK, "iter_limit": 2000}}
        self._solver = ca.conic("axis", "daqp", shapes, options)
        self._y, self._unit = np.zeros(intervals), np.ones(intervals)
        self._matrix = np.zeros((self._rows, intervals), order="F")
        self._low, self._high = np.zeros(self._rows), np.zeros(self._rows)
        self._lbx, self._ubx = np.zeros(intervals), np.zeros(intervals)
        self._buffer, self._evaluate = self._solver.buffer()
        names = [self._solver.name_in(i) for i in range(self._solver.n_in())]
        given = {"h": self._unit, "a": self._matrix.T.reshape(-1), "lba": self._low, "uba": self._high}
        given |= {"lbx": self._lbx, "ubx": self._ubx}
        for name, array in given.items():
            self._buffer.set_arg(names.index(name), _memory(array))
        self._buffer.set_res(self._solver.index_out("x"), _memory(self._y))

    def load(self, grid: AxisGrid) -> None:
        """Take over a grid's maps."""
        self._matrix[: self._fixed] = grid.ends
        self._matrix[self._fixed : -len(grid.steps)] = grid.rates[:-1]
        self._matrix[-len(grid.steps) :] = grid.positions[1:]
        self._lbx[:], self._ubx[:] = -grid.roots, grid.roots

    def solve(self, ends: np.ndarray, rate: float, lower: np.ndarray, upper: np.ndarray) -> np.ndarray | None:
        """y for the loaded grid, or None when nothing satisfies the bounds. All in units of the acceleration."""
        low, high = self._low, self._high
        low[: self._fixed] = high[: self._fixed] = ends
        low[self._fixed : -len(lower)], high[self._fixed : -len(lower)] = -rate, rate
        low[-len(lower) :], high[-len(lower) :] = lower, upper
        self._evaluate()
        stats: Any = self._buffer.stats()
        return self._y.copy() if stats["success"] else None


def solve_axis(
    grid: AxisGrid,
    solver: AxisSolver,
    ends: tuple[float, float],
    velocity: float,
    acceleration: float,
    lower: np.ndarray,
    upper: np.ndarray,
) -> np.ndarray | None:
    """Controls (N,) of least effort, or None when there are none within the bounds.

    Args:
        grid: the time grid; it must have been loaded into `solver`.
        solver: for this number of intervals and initial condition.
        ends: first and last position.
        velocity, acceleration: bounds.
        lower, upper: of the position at the nodes 1 ... N, shape (N,).
    """
    first, last = ends
    conditions = np.zeros(len(grid.ends))
    conditions[0] = (last - first) / acceleration
    rate = velocity / acceleration
    low, high = (lower - first) / acceleration, (upper - first) / acceleration
    y = grid.inverse @ conditions
    rates, positions = grid.rates @ y, (grid.positions @ y)[1:]
    within = np.abs(y) <= grid.roots + SLACK
    if not (
        within.all()
        and (np.abs(rates) <= rate + SLACK).all()
        and (positions >= low - SLACK).all()
        and (positions <= high + SLACK).all()
    ):
        found = solver.solve(conditions, rate, low, high)
        if found is None:
            return None
        y = found
    controls: np.ndarray = acceleration * np.clip(y / grid.roots, -1.0, 1.0)
    return controls


def _memory(array: Any) -> memoryview:
    return memoryview(array)
