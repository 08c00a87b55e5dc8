"""Numbers of one route for its program: bounds, initial guess, time grid and parameters. A pure function of route,
problem and settings."""

import itertools

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.layout import Layout, Parameters, Variables
from agile_jax.expert.programs.program import Inputs, Program
from agile_jax.expert.search.profile import Profile, make_grid
from agile_jax.expert.search.routes import Route, waypoints
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.cells import Face
from agile_jax.scene import PLANAR, POSE_SIZE, least_height, speed_lines, top_speed

EDGE_SPEED = 0.5  # of the full speed, at which the guess goes around an edge
WARM_START_DECIMALS = 2  # of a solution from which the next one begins
SHORTEST_PHASE = 1e-3  # [s] keeps the program regular where a phase would vanish
LONGEST_PHASE = 1e3  # [s]
CROSSING_ROOM = 0.01  # [m] around a crossed face, so that its equality does not sit on a bound
LEAST_SPEED = 0.05  # [m/s] of the guess where the legs hardly move
LEAST_STEP = 0.05  # of the mean step: a switch nearer to another break is not made a node


def make_inputs(
    problem: Problem,
    route: Route,
    margin: float,
    program: Program,
    weight: float,
    profile: Profile | None = None,
    slowness: float = 1.0,
    phase_times: np.ndarray | None = None,
    heights: np.ndarray | None = None,
) -> Inputs:
    """Bounds, grid and initial guess of a route.

    Args:
        problem: start, target and bounds.
        route: from the start to the target.
        margin: by which its regions' faces are enlarged [m].
        program: for its pattern of phases.
        weight: of the effort.
        profile: of the slowest axis. Its switches become nodes, which lets the least time be attained.
        slowness: factor on the durations of the guess, straight lines through the waypoints.
        phase_times: when the phases begin and end, shape (P+1,) [s], where the profile does not tell.
        heights: of the intervals, shape (T,), at which the lines touch the top speed [m]; when not given, the lowest of
            the guess in each phase, whose flat lines leave any height some speed.
    """
    layout = program.layout
    guess = _guess(problem, route, layout, slowness)
    if heights is None:
        lowest = np.minimum.reduceat(middle_heights(guess.poses), layout.first_nodes)
        heights = np.repeat(lowest, layout.intervals)
    fractions = _fractions(route, layout, profile, problem.settings, phase_times)
    parameters = Parameters(
        problem.start,
        problem.target,
        [_crossing_parameters(face) for face in route.crossed],
        [row for region in route.regions for row in region.rows],
        [np.append(region.edge, margin) for region in route.regions if region.edge is not None],
        lines_at(problem, heights[layout.slow_intervals]).ravel(),
        fractions,
        np.array([weight]),
    )
    lower, upper = _variable_bounds(problem, route, layout)
    return Inputs(
        layout.pack(guess),
        layout.pack(lower),
        layout.pack(upper),
        *_row_bounds(route, program, problem.settings.limits.velocity),
        np.concatenate(parameters.in_order()),
        fractions,
    )


def disturbed(inputs: Inputs, seed: int) -> Inputs:
    """The same problem from another guess: every variable moved by about 0.05 or 0.1, within its bounds."""
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    noise = 0.05 * (1 + seed % 2) * generator.standard_normal(inputs.guess.shape)
    return inputs._replace(guess=np.clip(inputs.guess + noise, inputs.lower, inputs.upper))


def warm_started(inputs: Inputs, program: Program, variables: np.ndarray) -> Inputs:
    """The same problem from about a solution, such that all who have found it begin at the very same place.

    Angles of planes that the torso does not touch are not determined, so they begin where they always do.
    """
    guess, angles = np.round(variables, WARM_START_DECIMALS), program.layout.places.angles
    guess[angles] = inputs.guess[angles]
    return inputs._replace(guess=np.clip(guess, inputs.lower, inputs.upper))


def _guess(problem: Problem, route: Route, layout: Layout, slowness: float) -> Variables:
    """Straight lines through the waypoints, at a constant rate in each phase."""
    points, (velocity, acceleration) = waypoints(route, problem), problem.settings.limits
    edges = [phase.edge for phase in layout.phases]
    velocities = np.tile(velocity, (len(points) - 1, 1))
    slowest = top_speed(problem.scene, np.minimum(points[1:, 2], points[:-1, 2]))
    velocities[:, PLANAR] = np.minimum(velocities[:, PLANAR], np.maximum(slowest, LEAST_SPEED)[:, None])
    times = np.max(np.abs(np.diff(points, axis=0)) / velocities, axis=1)
    times = slowness * np.where(edges, times / EDGE_SPEED, times + np.max(velocity / acceleration) / 2)
    counts = [*layout.intervals[:-1], layout.intervals[-1] + 1]  # nodes
    poses, rates = [], []
    for p, count in enumerate(counts):
        move, share = points[p + 1] - points[p], (np.arange(count) / layout.intervals[p])[:, None]
        poses.append(points[p] + share * move)
        rates.append(np.tile(move / times[p] / slowness, (count, 1)))
    still = np.zeros((layout.nodes + 1, POSE_SIZE))
    return Variables(
        poses=np.concatenate(poses),
        rates=np.concatenate(rates),
        durations=np.repeat(times, counts),
        accelerations=still if layout.linear else still[:0],
        controls=still[1:],
        angles=np.full(len(layout.places.angles), np.pi / 4),
        next_durations=times[1:],
    )


def middle_heights(poses: np.ndarray) -> np.ndarray:
    """About the heights of the intervals between poses, shape (T+1, 4), in their middles. Shape (T,) [m]."""
    return (poses[1:, 2] + poses[:-1, 2]) / 2


def lines_at(problem: Problem, heights: np.ndarray) -> np.ndarray:
    """Intercepts and slopes of lines that touch the top speed at heights, shape (S,). Shape (S, 2) [m/s, 1/s].

    Where it is no bound they touch it where it begins to be one: a steeper line would be a tighter bound below.
    """
    fastest = max(problem.settings.velocity[i] for i in PLANAR)
    below = np.minimum(heights, least_height(problem.scene, fastest))
    lines = speed_lines(problem.scene)
    return lines[np.argmax(lines[:, 0] + lines[:, 1] * below[:, None], axis=1)] if len(lines) else np.zeros((0, 2))


def _variable_bounds(problem: Problem, route: Route, layout: Layout) -> tuple[Variables, Variables]:
    """Lower and upper bounds of the variables; those of poses inside phases are rows of the program."""
    velocity, acceleration = problem.settings.limits
    nodes, later = layout.nodes + 1, len(layout.phases) - 1
    accelerations = np.tile(acceleration, (nodes if layout.linear else 0, 1))
    upper = Variables(
        poses=np.full((nodes, POSE_SIZE), np.inf),
        rates=np.tile(velocity, (nodes, 1)),
        durations=np.append(LONGEST_PHASE, np.full(nodes - 1, np.inf)),
        accelerations=accelerations,
        controls=np.tile(acceleration, (layout.nodes, 1)),
        angles=np.full(len(layout.places.angles), np.pi / 2),
        next_durations=np.full(later, LONGEST_PHASE),
    )
    lower = Variables(
        poses=-upper.poses,
        rates=-upper.rates,
        durations=np.append(SHORTEST_PHASE, np.full(nodes - 1, -np.inf)),
        accelerations=-accelerations,
        controls=-upper.controls,
        angles=0 * upper.angles,
        next_durations=np.full(later, SHORTEST_PHASE),
    )
    neighbours = zip(itertools.pairwise(route.regions), route.crossings, layout.first_nodes[1:], strict=True)
    for (before, after), crossing, node in neighbours:
        low, high = np.maximum(after.lower, before.lower), np.minimum(after.upper, before.upper)
        low[3], high[3] = crossing.lower[3], crossing.upper[3]
        _make_room(low, high, crossing.face)
        lower.poses[node], upper.poses[node] = low, high
    return lower, upper


def _make_room(low: np.ndarray, high: np.ndarray, crossed: Face) -> None:
    """Widen the bounds of a crossing's node, in place, where the crossing's own constraint holds already."""
    if crossed.row is None:
        value = crossed.normal[crossed.axis] * crossed.value
        low[crossed.axis], high[crossed.axis] = value - CROSSING_ROOM, value + CROSSING_ROOM
    else:
        low[:2] -= CROSSING_ROOM
        high[:2] += CROSSING_ROOM


def _crossing_parameters(face: Face) -> np.ndarray:
    """Normal, its direction in the plane, weight of the footprint, offset. Shape (7,)."""
    if face.row is None:
        return np.array([*face.normal, 1.0, 0.0, 0.0, face.value])
    length = np.hypot(face.normal[0], face.normal[1])
    return np.array([*face.normal, *(face.normal[:2] / length), length, face.row[3]])


def _row_bounds(route: Route, program: Program, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of all m constraints, (m,) and (m,)."""
    lower: list[float] = []
    upper: list[float] = []
    for kind, node, phase, size, face in program.rows:
        region = route.regions[phase]
        if kind == "touch":
            # The crossing may put the torso on this very face.
            crossed = route.crossed[program.layout.phase_of[node] - 1].row
            lower += [-float(crossed is not None and np.array_equal(crossed, region.rows[face]))] * size
            upper += [np.inf] * size
        elif kind in ("face", "edge", "line"):
            lower += [0.0] * size
            upper += [np.inf] * size
        elif kind == "rate":
            lower += [*-velocity]
            upper += [*velocity]
        elif kind == "pose":
            lower += [*region.lower]
            upper += [*region.upper]
        elif kind == "speed":
            lower.append(-np.inf)
            upper.append(1.0)
        else:
            lower += [0.0] * size
            upper += [0.0] * size
    return np.array(lower), np.array(upper)


def _fractions(
    route: Route,
    layout: Layout,
    profile: Profile | None,
    settings: ExpertSettings,
    phase_times: np.ndarray | None,
) -> np.ndarray:
    """Lengths of all intervals (T,), as fractions of their phase: even between the switches of the slowest axis."""
    even = np.concatenate([np.full(count, 1 / count) for count in layout.intervals])
    if profile is None or settings.zero_end_controls or settings.transcription != "zoh" or profile.duration <= 0:
        return even
    if phase_times is not None:
        times = phase_times.tolist()
    elif any(face.axis != profile.axis or abs(face.normal[face.axis]) != 1 for face in route.crossed):
        return even
    else:
        values = [face.normal[face.axis] * (face.value + face.reach / 2) for face in route.crossed]
        times = [0.0, *(profile.time_at(value) for value in values), profile.duration]
    pieces = []
    for count, (begin, end) in zip(layout.intervals, itertools.pairwise(times), strict=True):
        apart = max(end - begin, 0.0) * LEAST_STEP / count
        inner = [s - begin for s in profile.switches if begin + apart < s < end - apart]
        grid = make_grid(inner, end - begin, count, apart) if end - begin > SHORTEST_PHASE else None
        pieces.append(np.full(count, 1 / count) if grid is None else np.diff(grid) / (end - begin))
    return np.concatenate(pieces)
