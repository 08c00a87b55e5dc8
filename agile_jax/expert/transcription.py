"""The minimum-time problem along a route as a nonlinear program in CasADi, and its solution.

    minimise    T + w * integral of sum_i (u_i / a_i)^2 dt
    subject to  s'' = u,  s(0) = start,  s'(0) = 0 or free,  s(T) = target,  s'(T) = 0,
                |s'_i| <= v_i,  |u_i| <= a_i,  s(t) in region p during phase p,  pinned boundaries.

Direct collocation with piecewise-constant u, for which the double integrator's transcription is exact: over an
interval of length h, s+ = s + h s' + h^2 u / 2 and s'+ = s' + h u. The rate is piecewise linear, so bounds at the
nodes hold everywhere. Each of the P phases has its own duration tau, carried as a state so that the problem keeps its
stage structure (FATROP needs it, variables x_0, u_0, x_1, ..., x_N); regions are simple bounds. The structure depends
on P alone, so one program serves all routes of P phases.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from agile_jax.expert.routes import Route, waypoints
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Trajectory
from agile_jax.scene import POSE_SIZE

SHORTEST_PHASE = 1e-3  # [s] keeps the program regular where a phase would vanish
LONGEST_PHASE = 1e3  # [s]
PIN_ROOM = 0.01  # [m] around a pinned value, so that its equality does not sit on a bound

STATE = 2 * POSE_SIZE + 1  # s, s', tau

# Iterations are limited, not seconds: a label must not depend on the machine's load.
FATROP = {"print_level": 0, "tol": 1e-8, "constr_viol_tol": 1e-9, "mu_init": 1e-2, "max_iter": 100}
IPOPT = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    "constr_viol_tol": 1e-10,
    "max_iter": 150,
    "linear_solver": "mumps",
    "option_file_name": "",  # else a file ipopt.opt in the working folder would silently change labels
}


class Program(NamedTuple):
    """A solver for all routes of one number of phases."""

    solver: Any  # casadi.Function
    intervals: tuple[int, ...]  # per phase


def split_nodes(nodes: int, phases: int) -> tuple[int, ...]:
    """Intervals of each phase: as even as possible, earlier phases first."""
    return tuple(nodes // phases + (p < nodes % phases) for p in range(phases))


def build_program(phases: int, initial_velocity: str, settings: ExpertSettings, solver: str = "fatrop") -> Program:
    """Build the program for routes of `phases` phases; `solver` is "fatrop" or "ipopt"."""
    intervals = split_nodes(settings.nodes, phases)
    phase_of = np.repeat(np.arange(phases), intervals)
    start, target = ca.SX.sym("start", POSE_SIZE), ca.SX.sym("target", POSE_SIZE)
    pin_axis, pin_value = ca.SX.sym("pin_axis", POSE_SIZE, phases - 1), ca.SX.sym("pin_value", phases - 1)
    scale = np.array(settings.acceleration)

    states = [ca.SX.sym(f"x{k}", STATE) for k in range(settings.nodes + 1)]
    variables: list[Any] = []
    constraints: list[Any] = []
    objective: Any = 0
    for k, p in enumerate(phase_of):
        pose, rate, tau = states[k][:POSE_SIZE], states[k][POSE_SIZE:-1], states[k][-1]
        ends_phase = k + 1 < settings.nodes and phase_of[k + 1] != p
        control = ca.SX.sym(
            f"u{k}", POSE_SIZE + ends_phase
        )  # the next phase's duration is chosen at the end of this one
        u, h = control[:POSE_SIZE], tau / intervals[p]
        following = ca.vertcat(pose + h * rate + h**2 / 2 * u, rate + h * u, control[-1] if ends_phase else tau)
        variables += [states[k], control]
        # FATROP finds the stages by these rows: the step first, then what holds at the node.
        constraints.append(states[k + 1] - following)
        if k == 0:
            constraints.append(pose - start)
            if initial_velocity == "rest":
                constraints.append(rate)
        elif p != phase_of[k - 1]:
            constraints.append(ca.dot(pin_axis[:, int(p) - 1], pose) - pin_value[int(p) - 1])
        if settings.zero_end_controls and k in (0, settings.nodes - 1):
            constraints.append(u)
        objective += h * (1 + settings.effort_weight * ca.sumsqr(u / scale))
    variables.append(states[-1])
    constraints += [states[-1][:POSE_SIZE] - target, states[-1][POSE_SIZE:-1]]

    equalities = ca.vertcat(*constraints)
    problem = {
        "x": ca.vertcat(*variables),
        "f": objective,
        "g": equalities,
        "p": ca.vertcat(start, target, ca.vec(pin_axis), pin_value),
    }
    options: dict[str, Any] = {"expand": True, "print_time": False, "error_on_fail": False}
    if solver == "fatrop":
        options |= {"structure_detection": "auto", "equality": [True] * equalities.numel(), "fatrop": FATROP}
    else:
        options |= {"ipopt": IPOPT}
    return Program(ca.nlpsol(f"route_{phases}_{initial_velocity}", solver, problem, options), intervals)


class Arguments(NamedTuple):
    """Numbers of one route for its program."""

    guess: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    parameters: np.ndarray


def make_arguments(
    route: Route, program: Program, start: np.ndarray, target: np.ndarray, settings: ExpertSettings
) -> Arguments:
    """Bounds and initial guess of a route: straight lines through its waypoints, a pure function of the arguments."""
    points = waypoints(route, start, target)
    velocity, acceleration = np.array(settings.velocity), np.array(settings.acceleration)
    times = np.max(np.abs(np.diff(points, axis=0)) / velocity, axis=1) + np.max(velocity / acceleration) / 2
    guess, lower, upper = [], [], []
    for p, region in enumerate(route.regions):
        count = program.intervals[p]
        step = points[p + 1] - points[p]
        for j in range(count + (p + 1 == len(route.regions))):
            low, high = region.lower, region.upper
            if j == 0 and p > 0:
                before, (axis, value) = route.regions[p - 1], route.pins[p - 1]
                low, high = np.maximum(low, before.lower), np.minimum(high, before.upper)
                low[axis], high[axis] = value - PIN_ROOM, value + PIN_ROOM
            guess += [*(points[p] + step * j / count), *(step / times[p]), times[p]]
            lower += [*low, *-velocity, SHORTEST_PHASE]
            upper += [*high, *velocity, LONGEST_PHASE]
            if j < count:
                guess += [0.0] * POSE_SIZE
                lower += [*-acceleration]
                upper += [*acceleration]
                if j + 1 == count and p + 1 < len(route.regions):
                    guess.append(times[p + 1])
                    lower.append(SHORTEST_PHASE)
                    upper.append(LONGEST_PHASE)
    axes = np.zeros((len(route.pins), POSE_SIZE))
    for i, (axis, _) in enumerate(route.pins):
        axes[i, axis] = 1.0
    parameters = np.concatenate([start, target, axes.ravel(), [value for _, value in route.pins]])
    return Arguments(np.array(guess), np.array(lower), np.array(upper), parameters)


def solve_program(program: Program, arguments: Arguments) -> tuple[Trajectory, float, bool, str]:
    """Run the solver. Returns the trajectory, the objective, whether the solver claims success, and its status."""
    result = program.solver(
        x0=arguments.guess, lbx=arguments.lower, ubx=arguments.upper, lbg=0, ubg=0, p=arguments.parameters
    )
    stats = program.solver.stats()
    trajectory = unpack(np.array(result["x"]).ravel(), program.intervals)
    return trajectory, float(result["f"]), bool(stats["success"]), str(stats["return_status"])


def unpack(variables: np.ndarray, intervals: tuple[int, ...]) -> Trajectory:
    """The trajectory in the program's vector of variables."""
    states, controls, steps = [], [], []
    position = 0
    for p, count in enumerate(intervals):
        for j in range(count):
            states.append(variables[position : position + STATE - 1])
            steps.append(variables[position + STATE - 1] / count)
            position += STATE
            controls.append(variables[position : position + POSE_SIZE])
            position += POSE_SIZE + (j + 1 == count and p + 1 < len(intervals))
    states.append(variables[position : position + STATE - 1])
    return Trajectory(np.concatenate([[0.0], np.cumsum(steps)]), np.array(states), np.array(controls))
