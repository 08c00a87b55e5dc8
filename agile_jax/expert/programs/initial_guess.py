"""Numbers of one route for its program: bounds, initial guess, time grid and parameters. A pure function of route,
start and settings."""

import itertools
from typing import Any

import numpy as np

from agile_jax.expert.programs.schemes import LINEAR
from agile_jax.expert.programs.transcription import Arguments, Program
from agile_jax.expert.search.profile import Profile, make_grid
from agile_jax.expert.search.routes import Route, waypoints
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.faces import NO_ROW, Face
from agile_jax.expert.space.regions import Region
from agile_jax.scene import POSE_SIZE

CROSSING = 0.5  # of the full speed, at which the guess goes around an edge
ABOUT = 2  # decimals of a solution from which the next one begins
SHORTEST_PHASE = 1e-3  # [s] keeps the program regular where a phase would vanish
LONGEST_PHASE = 1e3  # [s]
PIN_ROOM = 0.01  # [m] around a pinned value, so that its equality does not sit on a bound
LEAST_STEP = 0.05  # of the mean step: a switch nearer to another break is not made a node


def make_arguments(
    route: Route,
    margin: float,
    program: Program,
    start: np.ndarray,
    target: np.ndarray,
    settings: ExpertSettings,
    weight: float,
    profile: Profile | None = None,
    slowness: float = 1.0,
    boundaries: np.ndarray | None = None,
) -> Arguments:
    """Bounds, grid and initial guess of a route.

    Args:
        route: from `start` to `target`.
        margin: by which its regions' faces are enlarged [m].
        program: for its pattern of phases.
        start, target: poses, shape (4,).
        settings: bounds.
        weight: of the effort.
        profile: of the slowest axis. Its switches become nodes, which lets the least time be attained.
        slowness: factor on the durations of the guess, straight lines through the waypoints.
        boundaries: when the phases begin and end, shape (P+1,) [s], where the profile does not tell.
    """
    points = waypoints(route, start, target)
    velocity, acceleration = np.array(settings.velocity), np.array(settings.acceleration)
    edges = [phase.edge for phase in program.phases]
    times = np.max(np.abs(np.diff(points, axis=0)) / velocity, axis=1)
    times = slowness * np.where(edges, times / CROSSING, times + np.max(velocity / acceleration) / 2)
    linear = program.scheme in LINEAR
    unbounded = np.zeros(linear * POSE_SIZE), acceleration[: linear * POSE_SIZE]
    anywhere = np.full(POSE_SIZE, np.inf)
    guess: list[np.ndarray] = []
    lower: list[np.ndarray] = []
    upper: list[np.ndarray] = []
    for p, region in enumerate(route.regions):
        count, last = program.intervals[p], p + 1 == len(route.regions)
        move = points[p + 1] - points[p]
        share = (np.arange(count + last) / count)[:, None]

        def stack(*columns: Any, rows: int = count + last) -> np.ndarray:
            """One row a node: state, control."""
            return np.hstack([np.broadcast_to(c, (rows, np.shape(c)[-1])) for c in columns])

        still, hardest = unbounded
        angles = np.array([0.0, np.pi / 4, np.pi / 2])[:, None] if edges[p] else np.empty((3, 0))
        low = stack(-anywhere, -velocity, [-np.inf], -hardest, -acceleration, angles[0])
        high = stack(anywhere, velocity, [np.inf], hardest, acceleration, angles[2])
        if p == 0:
            low[0, 2 * POSE_SIZE], high[0, 2 * POSE_SIZE] = SHORTEST_PHASE, LONGEST_PHASE
        rate = move / times[p] / slowness
        nodes = stack(points[p] + share * move, rate, [times[p]], still, np.zeros(POSE_SIZE), angles[1])
        if p > 0:
            before = route.regions[p - 1]
            low[0, :POSE_SIZE] = np.maximum(region.lower, before.lower)
            high[0, :POSE_SIZE] = np.minimum(region.upper, before.upper)
            low[0, 3], high[0, 3] = route.boundaries[p - 1].lower[3], route.boundaries[p - 1].upper[3]
            _make_room(low[0], high[0], route.pins[p - 1])
        # The last node has no control; at the end of the other phases it also chooses the next duration.
        for target_list, rows, extra in (
            (guess, nodes, times[p + 1] if not last else 0.0),
            (lower, low, SHORTEST_PHASE),
            (upper, high, LONGEST_PHASE),
        ):
            target_list.append(rows.ravel()[:-POSE_SIZE] if last else np.append(rows.ravel(), extra))
    lower_rows, upper_rows = _row_bounds(route, program, velocity)
    fractions = _fractions(route, program, profile, settings, boundaries)
    faces = [face for region in route.regions for face in faces_with_rows(region)]
    rounded = [np.append(region.edge, margin) for region in route.regions if len(region.edge)]
    parameters = np.concatenate(
        [
            start,
            target,
            *(_pin_parameters(pin) for pin in route.pins),
            *faces,
            *rounded,
            fractions,
            [weight],
        ]
    )
    ends = np.concatenate(guess), np.concatenate(lower), np.concatenate(upper)
    return Arguments(*ends, lower_rows, upper_rows, parameters, fractions)


def faces_with_rows(region: Region) -> list[np.ndarray]:
    """The faces, each (4,), that the torso's corners must keep beyond; the others are bounds."""
    return [face for face in region.faces if face[:3].any()]


def disturbed(arguments: Arguments, seed: int) -> Arguments:
    """The same problem from another guess: every variable moved by about 0.05 or 0.1, within its bounds."""
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    noise = 0.05 * (1 + seed % 2) * generator.standard_normal(arguments.guess.shape)
    return arguments._replace(guess=np.clip(arguments.guess + noise, arguments.lower, arguments.upper))


def near(arguments: Arguments, program: Program, variables: np.ndarray) -> Arguments:
    """The same problem from about a solution, such that all who have found it begin at the very same place.

    Angles of planes that the torso does not touch are not determined, so they begin where they always do.
    """
    guess = np.round(variables, ABOUT)
    guess[list(program.angles)] = arguments.guess[list(program.angles)]
    return arguments._replace(guess=np.clip(guess, arguments.lower, arguments.upper))


def _make_room(low: np.ndarray, high: np.ndarray, pin: Face) -> None:
    """Widen the bounds of a boundary's node, in place, where the pin holds already."""
    if pin.row is NO_ROW:
        value = pin.normal[pin.axis] * pin.value
        low[pin.axis], high[pin.axis] = value - PIN_ROOM, value + PIN_ROOM
    else:
        low[:2] -= PIN_ROOM
        high[:2] += PIN_ROOM


def _pin_parameters(pin: Face) -> np.ndarray:
    """Normal, its direction in the plane, weight of the footprint, offset. Shape (7,)."""
    if pin.row is NO_ROW:
        return np.array([*pin.normal, 1.0, 0.0, 0.0, pin.value])
    length = np.hypot(pin.normal[0], pin.normal[1])
    return np.array([*pin.normal, *(pin.normal[:2] / length), length, pin.row[3]])


def _row_bounds(route: Route, program: Program, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of all rows, (m,) and (m,)."""
    firsts = np.cumsum([0, *program.intervals])[:-1]
    lower, upper = [], []
    touched: dict[tuple[int, int], int] = {}
    for kind, node, phase, count in program.constraints:
        if kind == "touch":
            face = faces_with_rows(route.regions[phase])[touched.get((node, phase), 0)]
            touched[node, phase] = touched.get((node, phase), 0) + 1
            # The pin may put the torso on this very face.
            pin = route.pins[int(np.searchsorted(firsts, node)) - 1]
            lower += [-float(np.array_equal(pin.row, face))] * count
            upper += [np.inf] * count
        elif kind in ("face", "edge"):
            lower += [0.0] * count
            upper += [np.inf] * count
        elif kind == "rate":
            lower += [*-velocity]
            upper += [*velocity]
        elif kind == "pose":
            lower += [*route.regions[phase].lower]
            upper += [*route.regions[phase].upper]
        elif kind == "speed":
            lower.append(-np.inf)
            upper.append(1.0)
        else:
            lower += [0.0] * count
            upper += [0.0] * count
    return np.array(lower), np.array(upper)


def _fractions(
    route: Route,
    program: Program,
    profile: Profile | None,
    settings: ExpertSettings,
    boundaries: np.ndarray | None,
) -> np.ndarray:
    """Lengths of all intervals (T,), as fractions of their phase: even between the switches of the slowest axis."""
    even = np.concatenate([np.full(count, 1 / count) for count in program.intervals])
    if profile is None or settings.zero_end_controls or settings.transcription != "zoh" or profile.duration <= 0:
        return even
    if boundaries is not None:
        edges = boundaries.tolist()
    elif any(pin.axis != profile.axis or abs(pin.normal[pin.axis]) != 1 for pin in route.pins):
        return even
    else:
        values = [pin.normal[pin.axis] * (pin.value + pin.reach / 2) for pin in route.pins]
        edges = [0.0, *(profile.time_at(value) for value in values), profile.duration]
    pieces = []
    for count, (begin, end) in zip(program.intervals, itertools.pairwise(edges), strict=True):
        apart = max(end - begin, 0.0) * LEAST_STEP / count
        inner = [s - begin for s in profile.switches if begin + apart < s < end - apart]
        grid = make_grid(inner, end - begin, count, apart) if end - begin > SHORTEST_PHASE else None
        pieces.append(np.full(count, 1 / count) if grid is None else np.diff(grid) / (end - begin))
    return np.concatenate(pieces)
