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

from agile_jax.expert.programs.axis_program import AxisSolver, Bounds, make_axis_grid, solve_axes
from agile_jax.expert.search.effort_bound import effort_bound
from agile_jax.expert.search.minimum_time import boundary_times
from agile_jax.expert.search.profile import Profile, make_grid
from agile_jax.expert.search.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Trajectory
from agile_jax.scene import POSE_SIZE

SHORTEST_DURATION = 1e-2  # [s] below it the program is badly scaled, and nobody needs a fast path
SAME_TIME = 1e-7  # [s] within which a node counts for both phases that meet there
SAMPLES = 24  # of a boundary's time at which its effort is bounded
EVALUATIONS = 6  # more of the effort, in the search for that time
STEP, EDGE = 0.06, 2e-3  # first step of the search and its resolution, relative to what the time may be
HOPELESS = 1.2  # the search around the first guess does not lower the effort by this factor
ORDER = (2, 0, 1, 3)  # of the axes: the height is what most often has too little time, it decides first


class CertifiedSolver(NamedTuple):
    """What does not depend on the start."""

    settings: ExpertSettings
    initial_velocity: str
    axis_solver: AxisSolver
    velocity: np.ndarray  # (4,) bounds
    acceleration: np.ndarray  # (4,)


class Task(NamedTuple):
    """One route for one start."""

    solver: CertifiedSolver
    route: Route
    profile: Profile  # of the slowest axis, `slowest_axis` of start and target
    start: np.ndarray  # (4,) pose
    target: np.ndarray  # (4,)


def make_certified_solver(settings: ExpertSettings, initial_velocity: str) -> CertifiedSolver:
    """Build the solver for one initial condition."""
    intervals = settings.nodes - 2 * settings.zero_end_controls
    axis_solver = AxisSolver(intervals, initial_velocity)
    return CertifiedSolver(
        settings, initial_velocity, axis_solver, np.array(settings.velocity), np.array(settings.acceleration)
    )


def applies(settings: ExpertSettings, initial_velocity: str) -> bool:
    """Whether the settings allow the lower bound to be attained by axes that are independent of each other."""
    return (
        settings.method == "auto"
        and settings.transcription == "zoh"
        and settings.velocity_bound == "axis"
        and (initial_velocity == "rest" or not settings.zero_end_controls)
    )


def solve_certified(task: Task, rival: float = np.inf) -> tuple[Trajectory, float] | None:
    """The trajectory along a route that takes the lower bound's time with the least effort, and that effort [s].

    None when the route does not allow it, has more than one boundary on other axes than the slowest, or has more
    effort than `rival`, which is already had. The time of one such boundary is found by a search in one variable; it
    depends on no guess. The paper's u_0 = u_N = 0 adds an interval of rest at either end, as long as the others are in
    the mean.
    """
    solver, route, profile, start, target = task
    if profile.duration < SHORTEST_DURATION:
        return None
    crossings: list[float] = [profile.time_at(pin.normal[pin.axis] * pin.value) for pin in route.pins]
    unknown = [p for p, pin in enumerate(route.pins) if pin.axis != profile.axis]
    if len(unknown) > 1:
        return None
    boxes = [(boundary.lower, boundary.upper) for boundary in route.boundaries]
    before, after = boundary_times(start.tolist(), boxes, target.tolist(), solver.settings, solver.initial_velocity)
    ends = [0.0, *crossings, profile.duration]
    for p in unknown:
        within = sorted(profile.time_at(box[profile.axis]) for box in boxes[p])
        low, high = max(ends[p], before[p], within[0]), min(ends[p + 2], profile.duration - after[p], within[1])
        if low >= high:
            return None
    for p, time in enumerate(crossings):
        if p not in unknown and not before[p] - SAME_TIME <= time <= profile.duration - after[p] + SAME_TIME:
            return None
    if not unknown:
        if any(b < a for a, b in itertools.pairwise(crossings)):
            return None
        if boxes and rival < np.inf and _effort_bound(task, crossings)[0] > rival:
            return None
        return _solve_at(task, crossings)

    p = unknown[0]
    times = low + (high - low) * (np.arange(SAMPLES) + 0.5) / SAMPLES
    bounds = _effort_bound(task, [*crossings[:p], times, *crossings[p + 1 :]])
    if bounds.min() > rival:
        return None

    def at(time: float) -> tuple[Trajectory, float] | None:
        return _solve_at(task, [*crossings[:p], time, *crossings[p + 1 :]])

    best = float(times[np.argmin(bounds)])
    others = sorted(times[SAMPLES // 10 :: SAMPLES // 5].tolist(), key=lambda time: abs(time - best))
    return _search(at, low, high, [best, *others], rival)


def _effort_bound(task: Task, crossings: Sequence[float | np.ndarray]) -> np.ndarray:
    """Lower bound of the effort when the boundaries are crossed at given times, for m choices of these, shape (m,)."""
    solver, route, profile, start, target = task
    others = [i for i in range(POSE_SIZE) if i != profile.axis]
    size = max(np.size(time) for time in crossings)
    lower = [np.array(boundary.lower)[others, None] for boundary in route.boundaries]
    upper = [np.array(boundary.upper)[others, None] for boundary in route.boundaries]
    times = [np.broadcast_to(time, size) for time in crossings]
    ends = start[others, None], target[others, None]
    energy = effort_bound(*ends, profile.duration, times, lower, upper, solver.initial_velocity)
    return np.asarray(profile.effort + solver.acceleration[others] ** -2.0 @ energy)


def _search(
    at: Callable[[float], tuple[Trajectory, float] | None],
    low: float,
    high: float,
    guesses: Sequence[float],
    rival: float,
) -> tuple[Trajectory, float] | None:
    """The least effort over a time in (low, high), from the first guess that is feasible; None when there is none.

    Successive parabolic interpolation: the effort is a smooth function of the time, and its bound has led near its
    least. Given up when the first effort is well above `rival`.
    """
    for x in guesses:
        best = at(x)
        if best is not None:
            break
    if best is None or best[1] > HOPELESS * rival:
        return None
    least, step = best[1], STEP * (high - low)
    edge = EDGE * (high - low)
    tried = {x: least}  # time: effort
    for _ in range(EVALUATIONS):
        time = _next_time(tried, low, high, step)
        time = min(max(time, low + edge), high - edge)
        if min(abs(time - known) for known in tried) < edge:
            break
        found = at(time)
        if found is None:  # what is feasible is on the side of the best
            low, high = (time, high) if time < x else (low, time)
            step /= 4
            continue
        tried[time] = found[1]
        if found[1] < least:
            x, best, least = time, found, found[1]
    return best


def _next_time(tried: dict[float, float], low: float, high: float, step: float) -> float:
    """Where to look after some times have been tried: the vertex of the parabola through the best three."""
    ranked = sorted(tried, key=tried.__getitem__)
    a = ranked[0]
    if len(ranked) == 1:
        return a + step if a + step < high else a - step
    b = ranked[1]
    if len(ranked) == 2:
        return a + np.copysign(step, a - b)
    c = ranked[2]
    slope_b, slope_c = (tried[b] - tried[a]) / (b - a), (tried[c] - tried[a]) / (c - a)
    curvature = (slope_b - slope_c) / (b - c)
    if curvature <= 0:
        return a + 2 * np.copysign(step, a - b)
    return float((a + b - slope_b / curvature) / 2)


def _solve_at(task: Task, crossings: Sequence[float]) -> tuple[Trajectory, float] | None:
    """`solve_certified` for boundaries that are crossed at given times."""
    solver, route, profile, start, target = task
    settings, axis = solver.settings, profile.axis
    padding = 1 if settings.zero_end_controls else 0
    times = make_grid([*crossings, *profile.switches], profile.duration, settings.nodes - 2 * padding)
    if times is None:
        return None
    position, rate, control = profile.states(times)

    lower = np.empty((len(times), POSE_SIZE))
    upper = np.empty((len(times), POSE_SIZE))
    nodes = [0, *(int(np.searchsorted(times, time - SAME_TIME)) for time in crossings), len(times) - 1]
    for p, region in enumerate(route.regions):
        lower[nodes[p] : nodes[p + 1] + 1], upper[nodes[p] : nodes[p + 1] + 1] = region.lower, region.upper
    for p, (boundary, node) in enumerate(zip(route.boundaries, nodes[1:-1], strict=True)):
        # A node counts for all regions that meet there.
        lower[node] = np.maximum(lower[node], route.regions[p].lower)
        upper[node] = np.minimum(upper[node], route.regions[p].upper)
        pin = boundary.pin
        if pin.axis != axis:
            lower[node, pin.axis] = upper[node, pin.axis] = pin.normal[pin.axis] * pin.value
    if (position < lower[:, axis] - SAME_TIME).any() or (position > upper[:, axis] + SAME_TIME).any():
        return None

    others = [i for i in ORDER if i != axis]
    bounds = Bounds(solver.velocity[others], solver.acceleration[others], lower[:, others], upper[:, others])
    grid = make_axis_grid(times)
    motion = solve_axes(grid, solver.axis_solver, start[others], target[others], bounds)
    if motion is None:
        return None
    states, controls = np.empty((len(times), 2 * POSE_SIZE)), np.empty((len(times) - 1, POSE_SIZE))
    states[:, others], states[:, [POSE_SIZE + i for i in others]] = motion.positions, motion.rates
    states[:, axis], states[:, POSE_SIZE + axis] = position, rate
    controls[:, others], controls[:, axis] = motion.controls, control
    effort = float(grid.steps @ ((controls / solver.acceleration) ** 2).sum(1))
    trajectory = Trajectory(times, states, controls)
    return (_with_rest(trajectory) if padding else trajectory), effort


def _with_rest(trajectory: Trajectory) -> Trajectory:
    """The same between two intervals of rest, each as long as the others in the mean."""
    times, states, controls = trajectory
    wait = times[-1] / len(controls)
    padded = np.concatenate([[0.0], times + wait, times[-1:] + 2 * wait])
    still = np.zeros((1, POSE_SIZE))
    return Trajectory(
        padded, np.concatenate([states[:1], states, states[-1:]]), np.concatenate([still, controls, still])
    )
