"""Solving one route by the general program: attempts, one after the other, until one is verified.

A label that all attempts fail on is kept as failed, with the cause of each. The attempt that a label came from is part
of it, so that what the later ones rescue is counted.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.initial_guess import disturbed, make_inputs, warm_started
from agile_jax.expert.programs.layout import Phase, split_nodes
from agile_jax.expert.programs.program import Program, Solved, solve_program
from agile_jax.expert.search.profile import Profile
from agile_jax.expert.search.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Residuals, Trajectory
from agile_jax.expert.space.regions import FreeSpace, planning_margin
from agile_jax.expert.verify import rejection, verify

FEWEST_INTERVALS = 4  # in a phase around no edge
# Relative excess over the lower bound up to which the slowest axis switches where it does at the bound.
SAME_SWITCHES = 1e-3
MOST_PROGRAMS = 12  # kept: each takes 10 to 20 MB, so that they bound the memory of a worker
NOISES = 1000  # sets the disturbances of the attempts apart from those that are asked for
SMOOTHING = 10  # factor on the weight of the effort, from which a route with detours is approached
SMOOTHING_GAP = 1e-2  # relative; the step from the smoother problem to the label changes the objective by about 0.1 %

AttemptName = Literal[
    "fatrop",
    "fatrop-careful",
    "fatrop-other-guess",
    "fatrop-disturbed",
    "fatrop-disturbed-again",
    "ipopt",
    "ipopt-other-guess",
]
ATTEMPT_NAMES: tuple[AttemptName, ...] = get_args(AttemptName)


class Attempt(NamedTuple):
    """One way to solve a route."""

    name: AttemptName
    solver: str
    slowness: float  # of the guess
    noise: int = 0  # that disturbs the guess, each number in its own way; 0: none


ATTEMPTS = (
    Attempt("fatrop", "fatrop", 1.0),
    Attempt("fatrop-careful", "fatrop-careful", 1.0),
    Attempt("fatrop-other-guess", "fatrop", 2.0),
    Attempt("fatrop-disturbed", "fatrop-careful", 1.0, 1),
    Attempt("fatrop-disturbed-again", "fatrop-careful", 1.0, 2),
    Attempt("ipopt", "ipopt", 1.0),
    Attempt("ipopt-other-guess", "ipopt", 2.0),
)


class RouteSolution(NamedTuple):
    """A verified trajectory along one route."""

    trajectory: Trajectory
    objective: float
    residuals: Residuals
    method: str  # name of the attempt, or "certified"


class Unsolved(NamedTuple):
    """Why a route has no solution."""

    cause: str
    leaves_bounds: bool = False  # at or between nodes: with a larger reserve there may be a solution


class _Task(NamedTuple):
    """One route, and how to begin."""

    problem: Problem
    space: FreeSpace
    route: Route
    profile: Profile
    phases: tuple[Phase, ...]
    guess: int


class _Verified(NamedTuple):
    """What an attempt found."""

    solved: Solved
    residuals: Residuals
    attempt: Attempt


class GeneralSolver:
    """The general programs for one torso, each built when it is first needed. They hold no state between calls."""

    def __init__(self, torso_half_size: np.ndarray, settings: ExpertSettings) -> None:
        self._torso_half_size, self._settings = torso_half_size, settings
        self._programs: dict[tuple[tuple[Phase, ...], bool, str, bool], Program] = {}

    def solve(
        self,
        problem: Problem,
        space: FreeSpace,
        route: Route,
        profile: Profile,
        first_attempt: AttemptName = "fatrop",
        guess: int = 0,
        rival: float = np.inf,
    ) -> RouteSolution | Unsolved:
        """The verified solution along a route, or why there is none.

        Args:
            problem: among the obstacles that the route heeds.
            space: the regions of the route.
            route: from the start to the target.
            profile: of the slowest axis.
            first_attempt: to begin with; those before it are tried last.
            guess: 0 for the usual initial guess; other numbers disturb it, each in its own way.
            rival: an objective that is already had; a route with detours that stays well above it is given up.
        """
        weight, nodes = self._settings.effort_weight, self._settings.nodes
        phases = tuple(Phase(region.edge is not None, len(region.rows)) for region in route.regions)
        if split_nodes(nodes, phases)[-1] < FEWEST_INTERVALS:  # the last phase is around no edge
            return Unsolved(f"{nodes} nodes are too few for {len(phases)} phases")
        task, failures = _Task(problem, space, route, profile, phases, guess), list[Unsolved]()
        begin = ATTEMPT_NAMES.index(first_attempt)
        attempts, used = ATTEMPTS[begin:] + ATTEMPTS[:begin], list[Attempt]()
        smoother: Solved | None = None
        if route.detours:
            found = self._first_verified(task, attempts, SMOOTHING * weight, failures)
            if found is None:
                return _all_of(failures)
            smoother = found.solved
            duration = smoother.trajectory.times[-1]
            if duration + (smoother.objective - duration) / SMOOTHING > rival * (1 + SMOOTHING_GAP):
                return Unsolved("another route is better")
            used, attempts = [found.attempt], ATTEMPTS
        found = self._first_verified(task, attempts, weight, failures, smoother)
        if found is None:
            return _all_of(failures)
        used.append(found.attempt)
        if route.detours and found.solved.trajectory.times[-1] <= profile.duration * (1 + SAME_SWITCHES):
            # The profile told nothing about these crossings; now that they are known, its switches can be nodes.
            phase_times = found.solved.trajectory.times[np.cumsum([0, *split_nodes(nodes, phases)])]
            better = self._first_verified(task, ATTEMPTS, weight, failures, found.solved, phase_times)
            if better is not None and better.solved.objective < found.solved.objective:
                found = better
        solved, residuals, _ = found
        return RouteSolution(solved.trajectory, solved.objective, residuals, max(used, key=ATTEMPTS.index).name)

    def _first_verified(
        self,
        task: _Task,
        attempts: Sequence[Attempt],
        weight: float,
        failures: list[Unsolved],
        previous: Solved | None = None,
        phase_times: np.ndarray | None = None,
    ) -> _Verified | None:
        """The first solution that is verified, from the guess or from another solution; `failures` get the others."""
        problem, space = task.problem, task.space
        for attempt in attempts:
            program = self._program(task.phases, problem.from_rest, attempt.solver, space.exact)
            inputs = make_inputs(
                problem, task.route, space.margin, program, weight, task.profile, attempt.slowness, phase_times
            )
            if previous is not None:
                inputs = warm_started(inputs, program, previous.variables)
            elif task.guess or attempt.noise:
                inputs = disturbed(inputs, task.guess + NOISES * attempt.noise)
            solved = solve_program(program, inputs)
            if not solved.success:
                failures.append(Unsolved(f"{attempt.name}: status {solved.status}"))
                continue
            residuals = verify(
                problem.scene, self._settings, solved.trajectory, problem.start, problem.initial_velocity
            )
            # What only leads to the label need not keep the margin between nodes.
            rejected = rejection(residuals) if weight == self._settings.effort_weight else None
            if rejected is None:
                return _Verified(solved, residuals, attempt)
            leaves_bounds = rejected.kind in ("bounds", "clearance")
            failures.append(Unsolved(f"{attempt.name}: {rejected.text}", leaves_bounds))
            if leaves_bounds and space.margin < planning_margin(self._settings):
                break  # the other attempts would not do better, a larger reserve will
        return None

    def _program(self, phases: tuple[Phase, ...], from_rest: bool, solver: str, exact: bool) -> Program:
        # CasADi is loaded by the first solve: settings, verification and free space are read without it.
        from agile_jax.expert.programs.transcription import build_program

        key = (phases, from_rest, solver, exact)
        program = self._programs.pop(key, None)
        if program is None:
            half_size = self._torso_half_size if exact else None
            program = build_program(phases, from_rest, self._settings, solver, half_size)
        self._programs[key] = program  # last: the least recently used is first
        if len(self._programs) > MOST_PROGRAMS:
            del self._programs[next(iter(self._programs))]
        return program


def _all_of(failures: list[Unsolved]) -> Unsolved:
    causes = "; ".join(failure.cause for failure in failures)
    return Unsolved(causes, any(failure.leaves_bounds for failure in failures))
