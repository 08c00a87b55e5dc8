"""The fast path: labels whose duration is the analytic lower bound, hence globally optimal in time.

At the lower bound T the slowest axis is known in closed form (profile.py). Along a route whose boundaries are pinned
on that axis it also fixes when each region is entered, and what remains is the least effort of the other axes at a
fixed time within the regions: one convex program each (axis_program.py). A route without solution here is not
impossible; it needs more time than T, or a boundary elsewhere, and is left to the general program.
"""

import itertools
from typing import NamedTuple

import numpy as np

from agile_jax.expert.axis_program import AxisGrid, AxisSolver, make_axis_grid, solve_axis
from agile_jax.expert.profile import Profile, make_grid
from agile_jax.expert.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Trajectory
from agile_jax.scene import POSE_SIZE

SHORTEST_DURATION = 1e-2  # [s] below it the program is badly scaled, and nobody needs a fast path
SAME_TIME = 1e-7  # [s] within which a node counts for both phases that meet there


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


def crossing_times(route: Route, profile: Profile) -> list[float]:
    """When the slowest axis passes the route's boundaries, all pinned on that axis, in axis-aligned boxes [s]."""
    return [profile.time_at(pin.normal[pin.axis] * pin.value) for pin in route.pins]


def solve_certified(
    solver: CertifiedSolver, route: Route, profile: Profile, start: np.ndarray, target: np.ndarray
) -> tuple[Trajectory, float] | None:
    """The trajectory along a route that takes the lower bound's time with the least effort, and that effort [s].

    None when the route does not allow it.

    Args:
        solver: of `make_certified_solver`.
        route: from `start` to `target`.
        profile: `slowest_axis` of start and target.
        start, target: poses, shape (4,).
    """
    settings, axis = solver.settings, profile.axis
    if profile.duration < SHORTEST_DURATION or any(pin.axis != axis for pin in route.pins):
        return None
    crossings = crossing_times(route, profile)
    if any(b < a for a, b in itertools.pairwise(crossings)):
        return None
    times = make_grid([*crossings, *profile.switches], profile.duration, settings.nodes)
    if times is None:
        return None

    lower = np.full((len(times), POSE_SIZE), -np.inf)
    upper = np.full((len(times), POSE_SIZE), np.inf)
    edges = [0.0, *crossings, profile.duration]
    for region, begin, end in zip(route.regions, edges, edges[1:], strict=False):
        phase = (times >= begin - SAME_TIME) & (times <= end + SAME_TIME)
        lower[phase], upper[phase] = np.maximum(lower[phase], region.lower), np.minimum(upper[phase], region.upper)

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
