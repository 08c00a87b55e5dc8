"""Least effort of an axis at a fixed time: a convex quadratic program.

    minimise    sum_k h_k (u_k / a)^2
    subject to  p(0) = start,  p'(0) = 0 or free,  p(T) = target,  p'(T) = 0,  |p'_k| <= v,  |u_k| <= a,
                lower_k <= p_k <= upper_k

u is constant over each interval. Without active bounds its optimum is linear over the intervals' middles m_k (from rest
c (T - m_k) + d, with free initial velocity c m_k), which is found for all axes at once. What bounds this violates, goes
to DAQP, a dual active-set solver, in y_k = u_k sqrt(h_k) / a: the objective is |y|^2, and rates and positions are
linear in y; free initial velocity is eliminated by the final rest. The minimum is unique because the objective is
strictly convex. A dual method meets all bounds only at the optimum, so an answer that meets them is the optimum up to
rounding.
"""

from typing import Any, NamedTuple

import numpy as np

SLACK = 1e-9  # of the solver, in units of acceleration [s^2]
TOLERANCE = 1e-8  # of rates, positions and accelerations; far below the verifier's


class AxisGrid(NamedTuple):
    """One grid of N intervals."""

    times: np.ndarray  # (N+1,) [s]
    steps: np.ndarray  # (N,) [s]
    middles: np.ndarray  # (N,) [s]


class Bounds(NamedTuple):
    """What limits each of n axes [m or rad, and s]."""

    velocity: np.ndarray  # (n,)
    acceleration: np.ndarray  # (n,)
    lower: np.ndarray  # (N+1, n) of the position, at the nodes
    upper: np.ndarray  # (N+1, n)


class Motion(NamedTuple):
    """The motion of n axes on one grid [m or rad, and s]."""

    positions: np.ndarray  # (N+1, n)
    rates: np.ndarray  # (N+1, n)
    controls: np.ndarray  # (N, n) accelerations


def make_axis_grid(times: np.ndarray) -> AxisGrid:
    """The grid of times, shape (N+1,) [s]."""
    return AxisGrid(times, times[1:] - times[:-1], (times[1:] + times[:-1]) / 2)


def integrate_axes(grid: AxisGrid, controls: np.ndarray, first: np.ndarray, from_rest: bool) -> Motion:
    """The motion that controls, shape (N, n), lead to from positions, shape (n,); a free initial velocity is the one
    that ends at rest."""
    steps = grid.steps[:, None]
    changes = steps * controls
    rates, positions = np.zeros((2, len(steps) + 1, len(first)))
    np.cumsum(changes, axis=0, out=rates[1:])
    if not from_rest:
        rates -= rates[-1].copy()
    np.cumsum(steps * (rates[:-1] + changes / 2), axis=0, out=positions[1:])
    positions += first
    return Motion(positions, rates, controls)


def least_effort(grid: AxisGrid, first: np.ndarray, last: np.ndarray, from_rest: bool) -> np.ndarray:
    """Controls (N, n) of least effort between positions, shape (n,) each, when nothing is bounded."""
    steps, middles = grid.steps, grid.middles
    moves = last - first
    if not from_rest:
        return np.multiply.outer(middles, -moves / float(steps @ middles**2))
    left = grid.times[-1] - middles
    one, two, three = float(steps.sum()), float(steps @ left), float(steps @ left**2)
    slope = moves * (one / (one * three - two**2))
    return np.multiply.outer(left - two / one, slope)


class AxisSolver:
    """The program with its bounds, for grids of one number of intervals. Built once; holds no state between calls."""

    def __init__(self, intervals: int, from_rest: bool) -> None:
        self.from_rest = from_rest
        self._fixed = 2 if from_rest else 1  # rows of the end conditions: last position, and last rate when from rest
        rows = self._fixed + 2 * intervals - 1
        self._y, self._unit = np.zeros(intervals), np.ones(intervals)
        self._matrix = np.zeros((intervals, rows))  # transposed, which is how CasADi stores it
        self._low, self._high = np.zeros(rows), np.zeros(rows)
        self._lbx, self._ubx = np.zeros(intervals), np.zeros(intervals)
        self._rates = slice(self._fixed, self._fixed + intervals)  # at the nodes 0 ... N-1
        self._positions = slice(self._fixed + intervals, rows)  # at the nodes 1 ... N-1
        later = np.triu(np.ones((intervals, intervals)), 1)  # whether node j is after interval k
        self._moved = later if from_rest else later - 1.0
        self._solver: Any = None

    def _build(self) -> None:
        # CasADi is loaded when the first bound is active.
        import casadi

        ca: Any = casadi  # its type stubs do not know the buffer protocol
        intervals, rows = self._matrix.shape
        shapes = {"h": ca.Sparsity.diag(intervals), "a": ca.Sparsity.dense(rows, intervals)}
        options = {"error_on_fail": False, "daqp": {"primal_tol": SLACK, "iter_limit": 2000}}
        self._solver = ca.conic("axis", "daqp", shapes, options)
        self._buffer, self._evaluate = self._solver.buffer()
        names = [self._solver.name_in(i) for i in range(self._solver.n_in())]
        given = {"h": self._unit, "a": self._matrix.reshape(-1), "lba": self._low, "uba": self._high}
        given |= {"lbx": self._lbx, "ubx": self._ubx}
        for name, array in given.items():
            self._buffer.set_arg(names.index(name), array.data)
        self._buffer.set_res(self._solver.index_out("x"), self._y.data)

    def load(self, grid: AxisGrid) -> None:
        """Take over a grid: rates and positions, for unit acceleration, as rows of the program."""
        if self._solver is None:
            self._build()
        roots = np.sqrt(grid.steps)
        matrix, column = self._matrix, roots[:, None]
        np.multiply(self._moved, column, out=matrix[:, self._rates])
        nodes = grid.times[1:-1]
        if self.from_rest:
            moved = np.maximum(nodes - grid.middles[:, None], 0.0)
            matrix[:, 0] = (grid.times[-1] - grid.middles) * roots
            matrix[:, 1] = roots
        else:
            moved = -np.minimum(grid.middles[:, None], nodes)
            matrix[:, 0] = -grid.middles * roots
        np.multiply(moved, column, out=matrix[:, self._positions])
        self._lbx[:], self._ubx[:] = -roots, roots

    def solve(self, first: float, last: float, bounds: Bounds) -> np.ndarray:
        """Controls (N,) of one axis for the loaded grid; they break its bounds when nothing satisfies these."""
        low, high = self._low, self._high
        velocity, acceleration = float(bounds.velocity[0]), float(bounds.acceleration[0])
        lower, upper = bounds.lower[:, 0], bounds.upper[:, 0]
        low[: self._fixed] = high[: self._fixed] = 0.0
        low[0] = high[0] = (last - first) / acceleration
        low[self._rates], high[self._rates] = -velocity / acceleration, velocity / acceleration
        low[self._positions] = (lower[1:-1] - first) / acceleration
        high[self._positions] = (upper[1:-1] - first) / acceleration
        self._y[:] = np.nan
        self._evaluate()
        controls: np.ndarray = acceleration * np.clip(self._y / self._ubx, -1.0, 1.0)
        return controls


def solve_axes(
    grid: AxisGrid, solver: AxisSolver, first: np.ndarray, last: np.ndarray, bounds: Bounds
) -> Motion | None:
    """The motion of n axes of least effort, or None when one of them has none within its bounds.

    Args:
        grid: of the solver's number of intervals.
        solver: for this number of intervals and initial condition.
        first, last: positions, shape (n,).
        bounds: of the axes; the first one is tried first.
    """
    from_rest = solver.from_rest
    motion = integrate_axes(grid, least_effort(grid, first, last, from_rest), first, from_rest)
    bad = _broken(motion, bounds)
    if not bad.any():
        return motion
    solver.load(grid)
    controls = motion.controls
    for i in np.flatnonzero(bad):
        one = slice(i, i + 1)
        own = Bounds(bounds.velocity[one], bounds.acceleration[one], bounds.lower[:, one], bounds.upper[:, one])
        controls[:, i] = solver.solve(first[i], last[i], own)
        found = integrate_axes(grid, controls[:, one], first[one], from_rest)
        if not abs(found.positions[-1, 0] - last[i]) <= TOLERANCE or _broken(found, own)[0]:
            return None
        motion.positions[:, i], motion.rates[:, i] = found.positions[:, 0], found.rates[:, 0]
    return motion


def _broken(motion: Motion, bounds: Bounds) -> np.ndarray:
    """Which axes leave their bounds, shape (n,)."""
    positions, rates, controls = motion
    inside = (positions >= bounds.lower - TOLERANCE) & (positions <= bounds.upper + TOLERANCE)
    slow = np.abs(rates).max(0) <= bounds.velocity + TOLERANCE
    weak = np.abs(controls).max(0) <= bounds.acceleration + TOLERANCE
    return np.asarray(~(inside.all(0) & slow & weak))
