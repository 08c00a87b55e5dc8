"""Solving one route by the general program: attempts, one after the other, until one is verified.

A label that all attempts fail on is kept as failed, with the cause of each. The attempt that a label came from is part
of it, so that what the later ones rescue is counted.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np

from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.initial_guess import disturbed, make_inputs, middle_heights, warm_started
from agile_jax.expert.programs.layout import Phase, split_nodes
from agile_jax.expert.programs.program import Program, Solved, solve_program
from agile_jax.expert.search.profile import Profile
from agile_jax.expert.search.routes import Route
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Residuals, Trajectory
from agile_jax.expert.space.regions import FreeSpace, Region, planning_margin
from agile_jax.expert.verify import rejection, verify
from agile_jax.scene import PLANAR, top_speed, without_top_speed

FEWEST_INTERVALS = 4  # in a phase around no edge
# Relative excess over the lower bound up to which the slowest axis switches where it does at the bound.
SAME_SWITCHES = 1e-3
MOST_PROGRAMS = 12  # kept: each takes 10 to 20 MB, so that they bound the memory of a worker
ROUNDS = 6  # of programs after the first one with lines below the top speed
GAIN = 1e-4  # relative, of the objective, below which there is no further one
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
# With lines below the top speed a step of FATROP can lead to where its matrix has no full rank. There it repeats one
# correction without end: on about 1 in 200 labels under a low table. IPOPT takes up to twice as long.
SLOWED_ATTEMPTS = (*ATTEMPTS[5:], ATTEMPTS[1])


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
        phases = tuple(Phase(region.edge is not None, len(region.rows)) for region in route.regions)
        if split_nodes(self._settings.nodes, phases)[-1] < FEWEST_INTERVALS:  # the last phase is around no edge
            return Unsolved(f"{self._settings.nodes} nodes are too few for {len(phases)} phases")
        anywhere = problem._replace(scene=without_top_speed(problem.scene))
        task = _Task(anywhere, space, route, profile, phases, guess)
        begin = ATTEMPT_NAMES.index(first_attempt)
        found = self._solve(task, ATTEMPTS[begin:] + ATTEMPTS[:begin], rival)
        slow = [slow_axes(problem, region) for region in route.regions]
        if not isinstance(found, Unsolved) and any(slow):
            phases = tuple(phase._replace(slow=axes) for phase, axes in zip(phases, slow, strict=True))
            found = self._slowed(task._replace(problem=problem, phases=phases), found, rival)
        if isinstance(found, Unsolved):
            return found
        return RouteSolution(found.solved.trajectory, found.solved.objective, found.residuals, found.attempt.name)

    def _solve(self, task: _Task, attempts: Sequence[Attempt], rival: float) -> _Verified | Unsolved:
        """`solve`, as if the robot were as fast at any height."""
        weight, nodes = self._settings.effort_weight, self._settings.nodes
        profile, detours = task.profile, task.route.detours
        failures, used = list[Unsolved](), list[Attempt]()
        smoother: Solved | None = None
        if detours:
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
        if detours and found.solved.trajectory.times[-1] <= profile.duration * (1 + SAME_SWITCHES):
            # The profile told nothing about these crossings; now that they are known, its switches can be nodes.
            phase_times = found.solved.trajectory.times[np.cumsum([0, *split_nodes(nodes, task.phases)])]
            better = self._first_verified(task, ATTEMPTS, weight, failures, found.solved, phase_times)
            if better is not None and better.solved.objective < found.solved.objective:
                found = better
        return found._replace(attempt=max(used, key=ATTEMPTS.index))

    def _slowed(self, task: _Task, found: _Verified, rival: float) -> _Verified | Unsolved:
        """The solution within the top speed, from one that need not be: programs one after the other, each with lines
        below the top speed that touch it at the heights of the solution before, while they gain anything."""
        problem, settings = task.problem, self._settings
        residuals = verify(problem.scene, settings, found.solved.trajectory, problem.start, problem.initial_velocity)
        if rejection(residuals) is None:
            return found._replace(residuals=residuals)
        if found.solved.objective > rival * (1 + GAIN):
            return Unsolved("another route is better")
        failures = list[Unsolved]()
        for previous in (found.solved, None):  # None: the usual guess
            slower = self._first_verified(task, SLOWED_ATTEMPTS, settings.effort_weight, failures, previous)
            if slower is not None:
                break
        if slower is None:
            return _all_of(failures)
        used = max(found.attempt, slower.attempt, key=ATTEMPTS.index)
        for _ in range(ROUNDS):
            better = self._first_verified(task, SLOWED_ATTEMPTS[:1], settings.effort_weight, [], slower.solved)
            if better is None or better.solved.objective >= slower.solved.objective:
                break
            gain = 1 - better.solved.objective / slower.solved.objective
            slower = better
            if gain < GAIN:
                break
        return slower._replace(attempt=used)

    def _first_verified(
        self,
        task: _Task,
        attempts: Sequence[Attempt],
        weight: float,
        failures: list[Unsolved],
        previous: Solved | None = None,
        phase_times: np.ndarray | None = None,
    ) -> _Verified | None:
        """The first solution that is verified, from the guess or from another solution; `failures` get the others.

        From another solution the top speed is bounded by lines that touch it at the heights of that one.
        """
        problem, space = task.problem, task.space
        tried: set[str] = set()
        for attempt in attempts:
            if previous is not None and attempt.solver in tried:
                continue  # attempts with one solver differ in their guess only
            tried.add(attempt.solver)
            program = self._program(task.phases, problem.from_rest, attempt.solver, space.exact)
            heights = None if previous is None else middle_heights(previous.trajectory.states)
            inputs = make_inputs(
                problem, task.route, space.margin, program, weight, task.profile, attempt.slowness, phase_times, heights
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


def slow_axes(problem: Problem, region: Region) -> tuple[int, ...]:
    """The horizontal axes that a region's lowest poses bound more than the bounds of the velocity do."""
    lowest = float(top_speed(problem.scene, region.lower[2]))
    return tuple(axis for axis in PLANAR if lowest < problem.settings.velocity[axis])


def _all_of(failures: list[Unsolved]) -> Unsolved:
    causes = "; ".join(failure.cause for failure in failures)
    return Unsolved(causes, any(failure.leaves_bounds for failure in failures))
