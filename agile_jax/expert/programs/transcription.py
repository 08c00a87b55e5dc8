"""The minimum-time problem along a route as a nonlinear program in CasADi, and its solution.

    minimise    T + w * integral of sum_i (u_i / a_i)^2 dt
    subject to  s'' = u,  s(0) = start,  s'(0) = 0 or free,  s(T) = target,  s'(T) = 0,
                |s'_i| <= v_i,  |u_i| <= a_i,  s(t) in region p during phase p,  pinned boundaries.

Direct collocation by one of the schemes of schemes.py. Each of the P phases has its own duration tau, carried as a
state so that the problem keeps its stage structure (FATROP needs it, variables x_0, u_0, x_1, ..., x_N); for linear
controls the acceleration at the node is a state too, and the control is the acceleration at the next node. Regions
are simple bounds; where the footprint turns with the yaw, or an obstacle is not parallel to the axes, the corners of
the torso must stay beyond a face of every obstacle, which adds rows:

    n . (p + R(yaw) corner) >= offset          for the four corners, per obstacle and phase

In a phase around an edge (edges.py) n is between two normals, at an angle that is a control, and the rows are on all
Bernstein coefficients of the interval. The structure depends on which phases are around edges, on how many faces
have rows in each, and on the settings; one program serves all routes that agree in it.
Rates are bounded at the nodes, which is enough where they are linear; a rate that is quadratic over an interval also
keeps its middle Bernstein coefficient, s' + h u / 2, within the bound, hence the whole of it. Poses are bounded by the
inner Bernstein coefficients of each interval and, at the boundaries of phases, by the nodes: all other nodes lie
between two such coefficients, so that regions hold between nodes, too. (Rows of a turning torso are not linear in its
pose; there it holds up to r yaw'^2 h^2 / 8, and the verifier decides.)

FATROP drops rows whose bounds are both infinite, but keeps their last multipliers: which rows there are must depend on
the program alone, or labels would depend on what was solved before.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from agile_jax.expert.programs.schemes import LINEAR, control_points, square_integral, step
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Trajectory
from agile_jax.scene import POSE_SIZE

PIN = 7  # parameters of a pinned boundary: normal (3), direction in the plane (2), footprint's weight, offset
ROW = 4  # parameters of an obstacle's face: normal (3), offset
EDGE = 2 * ROW + 1  # parameters of an edge: its two faces, the margin
EDGE_INTERVALS = 3  # of a phase around an edge; it is short, and its path hardly curved
ROUNDING = 3e-3  # of the footprint's kinks in a pin; the pin then lies up to 1 mm beyond the face

# Iterations are limited, not seconds: a label must not depend on the machine's load.
FATROP = {"print_level": 0, "tol": 1e-8, "constr_viol_tol": 1e-9, "mu_init": 1e-2, "max_iter": 100}
# For what the first cannot solve: from farther inside the bounds, with more patience.
FATROP_CAREFUL = FATROP | {"mu_init": 1.0, "bound_push": 1e-1, "bound_frac": 1e-1, "max_iter": 300}
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    "constr_viol_tol": 1e-10,
    "max_iter": 500,
    "linear_solver": "mumps",
    "option_file_name": "",  # else a file ipopt.opt in the working folder would silently change labels
}
SOLVERS: dict[str, tuple[str, dict[str, Any]]] = {
    "fatrop": ("fatrop", FATROP),
    "fatrop-careful": ("fatrop", FATROP_CAREFUL),
    "ipopt": ("ipopt", IPOPT),
}


class Phase(NamedTuple):
    """What a program knows of a phase."""

    edge: bool  # whether it is around an edge
    faces: int  # that the corners must keep beyond


class Program(NamedTuple):
    """A solver for all routes of one pattern of phases."""

    solver: Any  # casadi.Function
    phases: tuple[Phase, ...]
    intervals: tuple[int, ...]  # per phase
    angles: tuple[int, ...]  # which variables are angles of planes around edges
    scheme: str
    constraints: tuple[tuple[str, int, int, int], ...]  # (kind, node, phase, rows) in the order of the program


def split_nodes(nodes: int, phases: Sequence[Phase]) -> tuple[int, ...]:
    """Intervals of each phase: few around an edge, the others as even as possible, earlier phases first."""
    others = [p for p, phase in enumerate(phases) if not phase.edge]
    left = nodes - EDGE_INTERVALS * (len(phases) - len(others))
    more = others[: left % len(others)]
    return tuple(EDGE_INTERVALS if q.edge else left // len(others) + (p in more) for p, q in enumerate(phases))


def build_program(
    phases: Sequence[Phase],
    initial_velocity: str,
    settings: ExpertSettings,
    solver: str = "fatrop",
    half_size: np.ndarray | None = None,
) -> Program:
    """Build the program for routes with one pattern of phases.

    Args:
        phases: P of them.
        initial_velocity: "rest" or "free".
        settings: nodes, scheme, weights.
        solver: a key of `SOLVERS`.
        half_size: of the torso, shape (3,) [m], where its yaw is to be heeded; None where the faces hold the footprint.
    """
    scheme, intervals = settings.transcription, split_nodes(settings.nodes, phases)
    linear = scheme in LINEAR
    half = np.ones(2) if half_size is None else half_size[:2]
    # Where the faces hold the footprint the torso is a point.
    signs = [(0, 0)] if half_size is None else [(i, j) for i in (1, -1) for j in (1, -1)]
    corners = [(i * half[0], j * half[1]) for i, j in signs]
    phase_of = np.repeat(np.arange(len(phases)), intervals)
    start, target = ca.SX.sym("start", POSE_SIZE), ca.SX.sym("target", POSE_SIZE)
    pins = ca.SX.sym("pins", PIN, len(phases) - 1)
    faces = [ca.SX.sym(f"faces{p}", ROW, phase.faces) for p, phase in enumerate(phases)]
    edges = {p: ca.SX.sym(f"edge{p}", EDGE) for p, phase in enumerate(phases) if phase.edge}
    fractions, weight = ca.SX.sym("fractions", settings.nodes), ca.SX.sym("weight")
    velocity, scale = np.array(settings.velocity), np.array(settings.acceleration)

    size = 2 * POSE_SIZE + 1 + linear * POSE_SIZE
    states = [ca.SX.sym(f"x{k}", size) for k in range(settings.nodes + 1)]
    variables: list[Any] = []
    angles: list[int] = []
    rows: list[Any] = []
    constraints: list[tuple[str, int, int, int]] = []
    objective: Any = 0

    def require(kind: str, node: int, phase: int, expression: Any) -> None:
        rows.append(expression)
        constraints.append((kind, node, phase, expression.numel()))

    def require_faces(kind: str, node: int, phase: int, point: Any) -> None:
        for i in range(phases[phase].faces):
            require(kind, node, phase, _corner_heights(point, faces[phase][:, i], corners))

    def require_speed(node: int, rate: Any) -> None:
        if settings.velocity_bound == "planar_norm":
            require("speed", node, 0, ca.sumsqr(rate[:2] / velocity[:2]))

    for k, p in enumerate(phase_of.tolist()):
        x = states[k]
        pose, rate, tau = x[:POSE_SIZE], x[POSE_SIZE : 2 * POSE_SIZE], x[2 * POSE_SIZE]
        ends_phase = k + 1 < settings.nodes and phase_of[k + 1] != p
        # The next phase's duration is chosen at the end of this one.
        control = ca.SX.sym(f"u{k}", POSE_SIZE + phases[p].edge + ends_phase)
        u, h = (x[-POSE_SIZE:] if linear else control[:POSE_SIZE]), tau * fractions[k]
        u_next = control[:POSE_SIZE]
        following = [*step(scheme, pose, rate, h, u, u_next), control[-1] if ends_phase else tau]
        if p in edges:
            angles.append(sum(v.numel() for v in variables) + size + POSE_SIZE)
        variables += [x, control]
        # FATROP finds the stages by these rows: the step first, then what holds at the node.
        require("step", k, p, states[k + 1] - ca.vertcat(*following, *([u_next] if linear else [])))
        if k == 0:
            require("end", k, p, pose - start)
            if initial_velocity == "rest":
                require("end", k, p, rate)
        elif p != phase_of[k - 1]:
            require("pin", k, p, _pin(x, pins[:, p - 1], half))
        if settings.zero_end_controls and (k == 0 or (k == settings.nodes - 1 and not linear)):
            require("end", k, p, u)
        if linear:
            require("rate", k, p, rate + h / 2 * u)
        points = control_points(scheme, pose, rate, h, u, u_next)
        for point in points[:-1]:
            require("pose", k, p, point)
            require_faces("face", k, p, point)
        require_speed(k, rate)
        if k > 0 and p != phase_of[k - 1]:
            require_faces("touch", k, p, pose)
            require_faces("touch", k, p - 1, pose)
        if p in edges:
            for point in (pose, *points):
                require("edge", k, p, _edge_heights(point, edges[p], control[POSE_SIZE], corners))
        effort = ca.sum1(square_integral(scheme, h, u / scale, u_next / scale))
        objective += h + weight * effort
    last, final = settings.nodes, states[-1]
    variables.append(final)
    require("end", last, len(phases) - 1, final[:POSE_SIZE] - target)
    require("end", last, len(phases) - 1, final[POSE_SIZE : 2 * POSE_SIZE])
    if settings.zero_end_controls and linear:
        require("end", last, len(phases) - 1, final[-POSE_SIZE:])

    constrained = ca.vertcat(*rows)
    problem = {
        "x": ca.vertcat(*variables),
        "f": objective,
        "g": constrained,
        "p": ca.vertcat(start, target, ca.vec(pins), *map(ca.vec, faces), *edges.values(), fractions, weight),
    }
    plugin, own = SOLVERS[solver]
    options: dict[str, Any] = {"expand": True, "print_time": False, "error_on_fail": False, plugin: own}
    if plugin == "fatrop":
        equality = [kind in ("step", "end", "pin") for kind, _, _, count in constraints for _ in range(count)]
        options |= {"structure_detection": "auto", "equality": equality}
    name = "route_" + "_".join(f"{phase.edge:d}{phase.faces}" for phase in phases)
    function = ca.nlpsol(name, plugin, problem, options)
    return Program(function, tuple(phases), intervals, tuple(angles), scheme, tuple(constraints))


def _corner_heights(state: Any, face: Any, corners: Sequence[tuple[float, float]]) -> Any:
    """How far the torso's corners lie beyond a face, shape (4,) for four of them."""
    x, y, z, yaw = (state[i] for i in range(POSE_SIZE))
    along = face[0] * ca.cos(yaw) + face[1] * ca.sin(yaw)
    across = face[1] * ca.cos(yaw) - face[0] * ca.sin(yaw)
    middle = face[0] * x + face[1] * y + face[2] * z - face[3]
    return ca.vertcat(*(middle + a * along + b * across for a, b in corners))


def _edge_heights(state: Any, edge: Any, angle: Any, corners: Sequence[tuple[float, float]]) -> Any:
    """How much farther than the margin the torso's corners lie beyond a plane through an edge."""
    first = _corner_heights(state, edge[:ROW], corners)
    second = _corner_heights(state, edge[ROW : 2 * ROW], corners)
    return ca.cos(angle) * first + ca.sin(angle) * second - edge[2 * ROW]


def _pin(state: Any, pin: Any, half: np.ndarray) -> Any:
    """Zero where the torso, or its centre when the footprint's weight is zero, touches the pinned plane."""
    yaw = state[3]
    along = pin[3] * ca.cos(yaw) + pin[4] * ca.sin(yaw)
    across = pin[4] * ca.cos(yaw) - pin[3] * ca.sin(yaw)
    footprint = half[0] * ca.sqrt(along**2 + ROUNDING**2) + half[1] * ca.sqrt(across**2 + ROUNDING**2)
    return ca.dot(pin[:3], state[:3]) - pin[5] * footprint - pin[6]


class Arguments(NamedTuple):
    """Numbers of one route for its program."""

    guess: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    lower_rows: np.ndarray
    upper_rows: np.ndarray
    parameters: np.ndarray
    fractions: np.ndarray  # (T,) of the phase's duration


class Solved(NamedTuple):
    """What the solver returns."""

    trajectory: Trajectory
    objective: float
    success: bool  # what the solver claims
    status: str
    variables: np.ndarray


def solve_program(program: Program, arguments: Arguments) -> Solved:
    """Run the solver."""
    result = program.solver(
        x0=arguments.guess,
        lbx=arguments.lower,
        ubx=arguments.upper,
        lbg=arguments.lower_rows,
        ubg=arguments.upper_rows,
        p=arguments.parameters,
    )
    stats = program.solver.stats()
    variables = np.array(result["x"]).ravel()
    trajectory = unpack(variables, program, arguments.fractions)
    return Solved(trajectory, float(result["f"]), bool(stats["success"]), str(stats["return_status"]), variables)


def unpack(variables: np.ndarray, program: Program, fractions: np.ndarray) -> Trajectory:
    """The trajectory in the program's vector of variables."""
    linear = program.scheme in LINEAR
    size = 2 * POSE_SIZE + 1 + linear * POSE_SIZE
    states, controls, steps = [], [], []
    position = k = 0
    for p, count in enumerate(program.intervals):
        for j in range(count):
            state = variables[position : position + size]
            states.append(state[: 2 * POSE_SIZE])
            steps.append(state[2 * POSE_SIZE] * fractions[k])
            position, k = position + size, k + 1
            controls.append(state[-POSE_SIZE:] if linear else variables[position : position + POSE_SIZE])
            position += POSE_SIZE + program.phases[p].edge + (j + 1 == count and p + 1 < len(program.intervals))
    final = variables[position : position + size]
    states.append(final[: 2 * POSE_SIZE])
    if linear:
        controls.append(final[-POSE_SIZE:])
    return Trajectory(np.concatenate([[0.0], np.cumsum(steps)]), np.array(states), np.array(controls))
