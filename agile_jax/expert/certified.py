"""The fast path: labels whose duration is the analytic lower bound, hence globally optimal in time.

At the lower bound T the slowest axis is known in closed form (profile.py). Along a route whose boundaries are pinned
on that axis it also fixes when each region is entered, and what remains is the least effort of the other axes at a
fixed time within the regions: one convex program each (axis_program.py). A route without solution here is not
impossible; it needs more time than T, or a boundary elsewhere, and is left to the general program.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.axis_program import AxisGrid, AxisSolver, make_axis_grid, solve_axis
from agile_jax.expert.minimum_time import minimum_time
from agile_jax.expert.profile import Profile, make_grid
from agile_jax.expert.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Trajectory
from agile_jax.scene import POSE_SIZE

SHORTEST_DURATION = 1e-2  # [s] below it the program is badly scaled, and nobody needs a fast path
SAME_TIME = 1e-7  # [s] within which a node counts for both phases that meet there
SCAN, SECTIONS = 5, 7  # evaluations of the search for the time of one boundary
HOPELESS = 1.3  # golden sections around the best of the scan do not lower the effort by this factor
GOLDEN = (5**0.5 - 1) / 2


class CertifiedSolver(NamedTuple):
    """What does not depend on the start."""

    settings: ExpertSettings
    initial_velocity: str
    axis_solver: AxisSolver


def make_certified_solver(settings: ExpertSettings, initial_velocity: str) -> CertifiedSolver:
    """Build the solver for one initial condition."""
    return CertifiedSolver(settings, initial_velocity, AxisSolver(settings.nodes, initial_velocity))


def applies(settings: ExpertSettings) -> bool:
    """Whether the settings allow the lower bound to be attained by axes that are independent of each other."""
    return (
        settings.method == "auto"
        and settings.transcription == "zoh"
        and settings.velocity_bound == "axis"
        and not settings.zero_end_controls
    )


def solve_certified(
    solver: CertifiedSolver,
    route: Route,
    profile: Profile,
    start: np.ndarray,
    target: np.ndarray,
    rival: float = np.inf,
) -> tuple[Trajectory, float] | None:
    """The trajectory along a route that takes the lower bound's time with the least effort, and that effort [s].

    None when the route does not allow it, or has more than one boundary on other axes than the slowest. The time of
    one such boundary is found by a search in one variable: a scan, then golden sections. It depends on no guess.

    Args:
        solver: of `make_certified_solver`.
        route: from `start` to `target`.
        profile: `slowest_axis` of start and target.
        start, target: poses, shape (4,).
        rival: an effort that is already had; a search whose scan stays well above it is given up.
    """
    settings = solver.settings
    if profile.duration < SHORTEST_DURATION:
        return None
    values = [pin.normal[pin.axis] * pin.value for pin in route.pins]
    crossings = [profile.time_at(value) for value in values]
    unknown = [p for p, pin in enumerate(route.pins) if pin.axis != profile.axis]
    if not unknown:
        return _solve_at(solver, route, profile, start, target, crossings)
    if len(unknown) > 1:
        return None

    p = unknown[0]
    before = crossings[p - 1] if p > 0 else 0.0
    after = crossings[p + 1] if p + 1 < len(crossings) else profile.duration
    # The pinned axis itself needs its time to get there, and from there to rest at the target.
    axis, velocity, acceleration = route.pins[p].axis, settings.velocity, settings.acceleration
    before = max(before, abs(values[p] - start[axis]) / velocity[axis])
    needed = minimum_time(target[axis] - values[p], velocity[axis], acceleration[axis], "free")
    after = min(after, profile.duration - float(needed))
    if before >= after:
        return None

    def at(time: float) -> tuple[Trajectory, float] | None:
        crossings[p] = time
        return _solve_at(solver, route, profile, start, target, crossings)

    return _search(at, before, after, rival)


def _search(
    at: Callable[[float], tuple[Trajectory, float] | None], low: float, high: float, rival: float
) -> tuple[Trajectory, float] | None:
    """The least effort over a time in (low, high); None when all that were tried are infeasible."""
    scan = np.linspace(low, high, SCAN + 2)
    results = [None, *(at(float(time)) for time in scan[1:-1]), None]
    efforts = [np.inf if result is None else result[1] for result in results]
    k = int(np.argmin(efforts))
    if not np.isfinite(efforts[k]) or efforts[k] > HOPELESS * rival:
        return None
    best = results[k]
    a, b = float(scan[k - 1]), float(scan[k + 1])
    inner = [b - GOLDEN * (b - a), a + GOLDEN * (b - a)]
    found = [at(time) for time in inner]
    for _ in range(SECTIONS):
        values = [np.inf if result is None else result[1] for result in found]
        for result in found:
            if result is not None and (best is None or result[1] < best[1]):
                best = result
        if not np.isfinite(values).any():  # what is feasible is around the best of the scan
            middle = float(scan[k])
            a, b = (a + middle) / 2, (b + middle) / 2
            inner = [b - GOLDEN * (b - a), a + GOLDEN * (b - a)]
            found = [at(time) for time in inner]
        elif values[0] <= values[1]:
            b, inner = inner[1], [inner[1] - GOLDEN * (inner[1] - a), inner[0]]
            found = [at(inner[0]), found[0]]
        else:
            a, inner = inner[0], [inner[1], inner[0] + GOLDEN * (b - inner[0])]
            found = [found[1], at(inner[1])]
    return best


def _solve_at(
    solver: CertifiedSolver,
    route: Route,
    profile: Profile,
    start: np.ndarray,
    target: np.ndarray,
    crossings: Sequence[float],
) -> tuple[Trajectory, float] | None:
    """`solve_certified` for boundaries that are crossed at given times."""
    settings, axis = solver.settings, profile.axis
    if any(b < a for a, b in itertools.pairwise(crossings)):
        return None
    times = make_grid([*crossings, *profile.switches], profile.duration, settings.nodes)
    if times is None:
        return None

    lower = np.full((len(times), POSE_SIZE), -np.inf)
    upper = np.full((len(times), POSE_SIZE), np.inf)
    for region, begin, end in zip(route.regions, [0.0, *crossings], [*crossings, profile.duration], strict=True):
        phase = (times >= begin - SAME_TIME) & (times <= end + SAME_TIME)
        lower[phase], upper[phase] = np.maximum(lower[phase], region.lower), np.minimum(upper[phase], region.upper)
    for pin, time in zip(route.pins, crossings, strict=True):
        if pin.axis != axis:
            node = int(np.argmin(np.abs(times - time)))
            lower[node, pin.axis] = upper[node, pin.axis] = pin.normal[pin.axis] * pin.value

    position, rate, control = profile.states(times)
    if (position < lower[:, axis] - SAME_TIME).any() or (position > upper[:, axis] + SAME_TIME).any():
        return None
    grid = make_axis_grid(times, solver.initial_velocity)
    solver.axis_solver.load(grid)
    controls = np.empty((settings.nodes, POSE_SIZE))
    controls[:, axis] = control
    # The height is what most often has too little time: it decides first.
    for i in sorted({*range(POSE_SIZE)} - {axis}, key=lambda i: i != 2):
        found = solve_axis(
            grid,
            solver.axis_solver,
            (start[i], target[i]),
            settings.velocity[i],
            settings.acceleration[i],
            lower[1:, i],
            upper[1:, i],
        )
        if found is None:
            return None
        controls[:, i] = found
    states = _states(grid, controls, start)
    states[:, axis], states[:, POSE_SIZE + axis] = position, rate
    effort = float(grid.steps @ ((controls / np.array(settings.acceleration)) ** 2).sum(1))
    return Trajectory(times, states, controls), effort


def _states(grid: AxisGrid, controls: np.ndarray, start: np.ndarray) -> np.ndarray:
    """States (N+1, 8) that the controls lead to."""
    weighted = controls * grid.roots[:, None]
    return np.hstack([start + grid.positions @ weighted, grid.rates @ weighted])
