"""The fast path: labels whose duration is the analytic lower bound, hence globally optimal in time.

At the lower bound T the slowest axis is known in closed form (profile.py). Along a route that crosses only on
that axis it also fixes when each region is entered, and what remains is the least effort of the other axes at a
fixed time within the regions: one convex program each (axis_program.py). A route without solution here is not
impossible; it needs more time than T, or a crossing elsewhere, and is left to the general program. So is a path that
the legs do not allow: where the slowest axis is horizontal its rate says how high the torso must be (scene/crouch.py),
and whether the other horizontal axis is slow enough is seen when the path is verified.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.axis_program import AxisSolver, Bounds, make_axis_grid, solve_axes
from agile_jax.expert.search.effort_bound import effort_bound
from agile_jax.expert.search.minimum_time import crossing_time_bounds
from agile_jax.expert.search.profile import Profile, make_grid
from agile_jax.expert.search.routes import Route, phase_speeds
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Trajectory
from agile_jax.expert.space.regions import TIGHTENING
from agile_jax.scene import PLANAR, POSE_NAMES, POSE_SIZE, least_height

SHORTEST_DURATION = 1e-2  # [s] below it the program is badly scaled, and nobody needs a fast path
SAME_TIME = 1e-7  # [s] within which a node counts for both phases that meet there
SAMPLES = 24  # of a crossing's time at which its effort is bounded
EVALUATIONS = 6  # more of the effort, in the search for that time
STEP, RESOLUTION = 0.06, 2e-3  # first step of the search and its resolution, relative to what the time may be
LARGEST_GAIN = 1.2  # the search around the first guess does not lower the effort by this factor
HEIGHT = POSE_NAMES.index("z")
AXIS_ORDER = (2, 0, 1, 3)  # the height is what most often has too little time, it decides first


class Task(NamedTuple):
    """One route of one problem."""

    solver: AxisSolver  # for the problem's initial velocity and intervals
    problem: Problem
    route: Route
    profile: Profile  # of the slowest axis


class Attained(NamedTuple):
    """A motion in the least time."""

    trajectory: Trajectory
    effort: float  # integral of sum (u / a)^2 [s]


def make_axis_solver(settings: ExpertSettings, from_rest: bool) -> AxisSolver:
    """Build the solver for one initial condition."""
    return AxisSolver(settings.nodes - 2 * settings.zero_end_controls, from_rest)


def applies(problem: Problem) -> bool:
    """Whether the settings allow the lower bound to be attained by axes that are independent of each other."""
    settings = problem.settings
    return (
        settings.method == "auto"
        and settings.transcription == "zoh"
        and settings.velocity_bound == "axis"
        and (problem.from_rest or not settings.zero_end_controls)
    )


def solve_certified(task: Task, rival: float = np.inf) -> Attained | None:
    """The trajectory along a route that takes the lower bound's time with the least effort.

    None when the route does not allow it, has more than one crossing on other axes than the slowest, or has more
    effort than `rival`, which is already had. The time of one such crossing is found by a search in one variable; it
    depends on no guess. The paper's u_0 = u_N = 0 adds an interval of rest at either end, as long as the others are in
    the mean.
    """
    route, profile = task.route, task.profile
    if profile.duration < SHORTEST_DURATION:
        return None
    unknown = [p for p, face in enumerate(route.crossed) if face.axis != profile.axis]
    if len(unknown) > 1:
        return None
    times: list[float] = [profile.time_at(face.normal[face.axis] * face.value) for face in route.crossed]
    before, after = crossing_time_bounds(task.problem, route.boxes, phase_speeds(task.problem, route.regions))
    for p, time in enumerate(times):
        if p not in unknown and not before[p] - SAME_TIME <= time <= profile.duration - after[p] + SAME_TIME:
            return None
    if unknown:
        p = unknown[0]
        within = sorted(profile.time_at(box[profile.axis]) for box in route.boxes[p])
        ends = [0.0, *times, profile.duration]
        low, high = max(ends[p], before[p], within[0]), min(ends[p + 2], profile.duration - after[p], within[1])
        return _solve_between(task, times, p, low, high, rival) if low < high else None
    if any(b < a for a, b in itertools.pairwise(times)):
        return None
    if times and rival < np.inf and _effort_bound(task, times)[0] > rival:
        return None
    return _solve_at(task, times)


def _solve_between(
    task: Task, times: Sequence[float], unknown: int, low: float, high: float, rival: float
) -> Attained | None:
    """`solve_certified` where one of the times of the crossings is unknown, but for its bounds."""
    samples = low + (high - low) * (np.arange(SAMPLES) + 0.5) / SAMPLES
    bounds = _effort_bound(task, [*times[:unknown], samples, *times[unknown + 1 :]])
    if bounds.min() > rival:
        return None

    def solve_at(time: float) -> Attained | None:
        return _solve_at(task, [*times[:unknown], time, *times[unknown + 1 :]])

    best = float(samples[np.argmin(bounds)])
    others = sorted(samples[SAMPLES // 10 :: SAMPLES // 5].tolist(), key=lambda time: abs(time - best))
    return _search(solve_at, low, high, [best, *others], rival)


def _effort_bound(task: Task, times: Sequence[float | np.ndarray]) -> np.ndarray:
    """Lower bound of the effort when the route crosses at given times, for m choices of these, shape (m,)."""
    problem, route, profile = task.problem, task.route, task.profile
    others = [i for i in range(POSE_SIZE) if i != profile.axis]
    size = max(np.size(time) for time in times)
    lower = [np.array(crossing.lower)[others, None] for crossing in route.crossings]
    upper = [np.array(crossing.upper)[others, None] for crossing in route.crossings]
    gates = [np.broadcast_to(time, size) for time in times]
    ends = problem.start[others, None], problem.target[others, None]
    energy = effort_bound(*ends, profile.duration, gates, lower, upper, problem.from_rest)
    return np.asarray(profile.effort + problem.settings.limits.acceleration[others] ** -2.0 @ energy)


def _search(
    solve_at: Callable[[float], Attained | None],
    low: float,
    high: float,
    guesses: Sequence[float],
    rival: float,
) -> Attained | None:
    """The least effort over a time in (low, high), from the first guess that is feasible; None when there is none.

    Successive parabolic interpolation: the effort is a smooth function of the time, and its bound has led near its
    least. Given up when the first effort is well above `rival`.
    """
    for x in guesses:
        best = solve_at(x)
        if best is not None:
            break
    if best is None or best.effort > LARGEST_GAIN * rival:
        return None
    least, step = best.effort, STEP * (high - low)
    resolution = RESOLUTION * (high - low)
    tried = {x: least}  # time: effort
    for _ in range(EVALUATIONS):
        time = _next_time(tried, low, high, step)
        time = min(max(time, low + resolution), high - resolution)
        if min(abs(time - known) for known in tried) < resolution:
            break
        found = solve_at(time)
        if found is None:  # what is feasible is on the side of the best
            low, high = (time, high) if time < x else (low, time)
            step /= 4
            continue
        tried[time] = found.effort
        if found.effort < least:
            x, best, least = time, found, found.effort
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


def _solve_at(task: Task, crossing_times: Sequence[float]) -> Attained | None:
    """`solve_certified` for crossings at given times."""
    problem, profile = task.problem, task.profile
    settings, axis = problem.settings, profile.axis
    padding = 1 if settings.zero_end_controls else 0
    times = make_grid([*crossing_times, *profile.switches], profile.duration, settings.nodes - 2 * padding)
    if times is None:
        return None
    position, rate, control = profile.states(times)
    lower, upper = _node_bounds(task, times, crossing_times)
    if axis in PLANAR and len(problem.scene.speed_heights):
        needed = least_height(problem.scene, np.abs(rate))
        needed[1:-1] += TIGHTENING  # for what happens between nodes
        lower[:, HEIGHT] = np.maximum(lower[:, HEIGHT], needed)
        if (lower[:, HEIGHT] > upper[:, HEIGHT]).any():
            return None
    if (position < lower[:, axis] - SAME_TIME).any() or (position > upper[:, axis] + SAME_TIME).any():
        return None

    others = [i for i in AXIS_ORDER if i != axis]
    velocity, acceleration = settings.limits
    bounds = Bounds(velocity[others], acceleration[others], lower[:, others], upper[:, others])
    grid = make_axis_grid(times)
    motion = solve_axes(grid, task.solver, problem.start[others], problem.target[others], bounds)
    if motion is None:
        return None
    states, controls = np.empty((len(times), 2 * POSE_SIZE)), np.empty((len(times) - 1, POSE_SIZE))
    states[:, others], states[:, [POSE_SIZE + i for i in others]] = motion.positions, motion.rates
    states[:, axis], states[:, POSE_SIZE + axis] = position, rate
    controls[:, others], controls[:, axis] = motion.controls, control
    effort = float(grid.steps @ ((controls / acceleration) ** 2).sum(1))
    trajectory = Trajectory(times, states, controls)
    return Attained(_with_rest(trajectory) if padding else trajectory, effort)


def _node_bounds(task: Task, times: np.ndarray, crossing_times: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the poses at the nodes of a grid, shape (N+1, 4) each, from the regions and crossings."""
    route = task.route
    lower, upper = np.empty((2, len(times), POSE_SIZE))
    nodes = [0, *(int(np.searchsorted(times, time - SAME_TIME)) for time in crossing_times), len(times) - 1]
    for p, region in enumerate(route.regions):
        lower[nodes[p] : nodes[p + 1] + 1], upper[nodes[p] : nodes[p + 1] + 1] = region.lower, region.upper
    for p, (face, node) in enumerate(zip(route.crossed, nodes[1:-1], strict=True)):
        # A node counts for all regions that meet there.
        lower[node] = np.maximum(lower[node], route.regions[p].lower)
        upper[node] = np.minimum(upper[node], route.regions[p].upper)
        if face.axis != task.profile.axis:
            lower[node, face.axis] = upper[node, face.axis] = face.normal[face.axis] * face.value
    return lower, upper


def _with_rest(trajectory: Trajectory) -> Trajectory:
    """The same between two intervals of rest, each as long as the others in the mean."""
    times, states, controls = trajectory
    wait = times[-1] / len(controls)
    padded = np.concatenate([[0.0], times + wait, times[-1:] + 2 * wait])
    still = np.zeros((1, POSE_SIZE))
    states = np.concatenate([states[:1], states, states[-1:]])
    return Trajectory(padded, states, np.concatenate([still, controls, still]))
