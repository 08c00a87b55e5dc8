"""Solving one start to global quality: every route that could be best, each verified, the best kept."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from agile_jax.expert.candidates import TIE_TOLERANCE, Candidate, best_of_branches, label_of, preferred
from agile_jax.expert.expert import Expert
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.axis_program import AxisSolver
from agile_jax.expert.programs.certified import Task, applies, make_axis_solver, solve_certified
from agile_jax.expert.programs.retries import AttemptName, GeneralSolver, RouteSolution, Unsolved
from agile_jax.expert.search.branches import branch_name
from agile_jax.expert.search.minimum_time import lower_bound
from agile_jax.expert.search.profile import Profile, slowest_axis
from agile_jax.expert.search.routes import Route, RouteSearch, waypoints
from agile_jax.expert.search.turns import split_turns
from agile_jax.expert.solution import CERTIFIED, ExpertSolution, Residuals, failed_solution, solved
from agile_jax.expert.space.nearby_obstacles import first_met, first_obstacles, straight_path, with_obstacles
from agile_jax.expert.space.regions import (
    ROUNDING_ERRORS,
    TIGHTENING,
    FreeSpace,
    boxes_suffice,
    make_free_space,
    planning_margin,
    regions_around,
)
from agile_jax.expert.verify import dense_poses, rejection, verify
from agile_jax.scene import POSE_SIZE

FAST_ROUTES = 200  # looked at by the fast path at most
NO_ROUTE = "no route: start or target is not free, or nothing connects them"
UNKNOWN = Residuals(np.nan, np.nan, np.nan, np.nan, np.nan, np.nan)


@dataclass(frozen=True, eq=False)
class MinimumTimeExpert(Expert):
    """The package's own expert. The solvers that it builds on first use hold no state between calls."""

    _axis_solvers: dict[bool, AxisSolver] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def _general(self) -> GeneralSolver:
        return GeneralSolver(self.scene.torso_half_size, self.settings)

    def _solve(self, problem: Problem, first_attempt: AttemptName, guess: int) -> ExpertSolution:
        chosen = first_obstacles(problem, planning_margin(self.settings))
        if problem.from_rest not in self._axis_solvers:
            self._axis_solvers[problem.from_rest] = make_axis_solver(self.settings, problem.from_rest)
        solvers = Solvers(self._axis_solvers[problem.from_rest], self._general, first_attempt, guess)
        while True:
            answer = LabelSearch(problem, chosen, solvers).solve()
            if isinstance(answer, ExpertSolution):
                return answer
            chosen = chosen | (problem.scene.obstacle_numbers == answer.number)


class MetObstacle(NamedTuple):
    """An obstacle that was left out of the search, and that the path comes too near to."""

    number: int


class Solvers(NamedTuple):
    """What solves routes, and how it begins."""

    axes: AxisSolver
    general: GeneralSolver
    first_attempt: AttemptName
    guess: int


class LabelSearch:
    """The search for the solution of one problem among some of its obstacles.

    Args:
        whole: the problem with all obstacles.
        chosen: which of the boxes are heeded, shape (n,), bool.
        solvers: for the problem's initial velocity.
    """

    def __init__(self, whole: Problem, chosen: np.ndarray, solvers: Solvers) -> None:
        self._whole, self._chosen, self._solvers = whole, chosen, solvers
        self._everything = bool(chosen.all())
        scene = whole.scene if self._everything else with_obstacles(whole.scene, chosen)
        self._problem = problem = whole._replace(scene=scene)
        self._bound = lower_bound(problem.start, problem.target, problem.settings, problem.initial_velocity)
        self._profile = slowest_axis(problem)

    def solve(self) -> ExpertSolution | MetObstacle:
        """The solution, or an obstacle beyond the chosen ones that it meets."""
        if applies(self._problem):
            attained = _attaining(self._whole, self._problem, self._profile, self._solvers.axes)
            if attained is not None:
                return self._solution(attained, [attained])
        return self._by_general_program()

    def _by_general_program(self) -> ExpertSolution | MetObstacle:
        """Where it takes the general program, its first path, or the straight lines along it, decide what it meets."""
        rounded = self._problem.settings.edges == "rounded"
        candidates: list[Candidate] = []
        failures: list[Unsolved] = []
        # The larger reserve is for what leaves its bounds between nodes, and makes square edges those of the fast path.
        for reserve in (ROUNDING_ERRORS, TIGHTENING) if rounded else (TIGHTENING,):
            failures = []
            for found in self._solved_routes(reserve, rounded, candidates, failures):
                if isinstance(found, MetObstacle):
                    return found
                candidates.append(found)
            if not any(failure.leaves_bounds for failure in failures):
                break
        if candidates:
            return self._solution(label_of(candidates, self._bound), candidates)
        causes = "; ".join(failure.cause for failure in failures)
        return failed_solution(self._problem.settings, self._bound, f"not solved: {causes}" if causes else NO_ROUTE)

    def _solved_routes(
        self, reserve: float, rounded: bool, candidates: list[Candidate], failures: list[Unsolved]
    ) -> Iterator[Candidate | MetObstacle]:
        """Yield the solutions along all routes that can be better than the `candidates`; `failures` get the others."""
        problem = self._problem

        def limit() -> float:
            return min((candidate.objective for candidate in candidates), default=np.inf) * (1 + TIE_TOLERANCE)

        space = self._free_space(reserve)
        routes = RouteSearch(space, problem, rounded=rounded).routes(limit)
        for tried, route in enumerate(split_turns(problem, space, routes)):
            if tried == problem.settings.max_routes or route.objective_bound > limit():
                return
            first = not candidates and not failures
            if first and (met := self._met(straight_path(waypoints(route, problem)))) is not None:
                yield met
                return
            found = self._solved_route(space, route, candidates)
            if isinstance(found, Unsolved):
                failures.append(found._replace(cause=f"{len(route.regions)} phases: {found.cause}"))
                continue
            if not candidates and (met := self._met_by(found)) is not None:
                yield met
                return
            yield found

    def _solved_route(self, space: FreeSpace, route: Route, candidates: list[Candidate]) -> Candidate | Unsolved:
        _, general, first_attempt, guess = self._solvers
        rival = min((candidate.objective for candidate in candidates), default=np.inf)
        found = general.solve(self._problem, space, route, self._profile, first_attempt, guess, rival)
        return found if isinstance(found, Unsolved) else _candidate(self._whole, route, found)

    def _free_space(self, reserve: float) -> FreeSpace:
        boxes = boxes_suffice(self._problem)
        space = make_free_space(self._problem, not boxes, reserve)
        if boxes and not regions_around(space, self._problem.start):
            # The start is nearer to a margin than the room that yaw gets.
            space = make_free_space(self._problem, True, reserve)
        return space

    def _solution(self, best: Candidate, candidates: list[Candidate]) -> ExpertSolution | MetObstacle:
        met = self._met_by(best)
        if met is not None:
            return met
        whole, (trajectory, objective, residuals, method) = self._whole, best.solution
        if not self._everything:
            residuals = verify(whole.scene, whole.settings, trajectory, whole.start, whole.initial_velocity)
        routes = tuple((candidate.branch, candidate.objective) for candidate in candidates)
        return solved(trajectory, residuals, self._bound, best.branch, objective, method, routes)

    def _met_by(self, candidate: Candidate) -> MetObstacle | None:
        scheme = self._problem.settings.transcription
        return self._met(dense_poses(candidate.solution.trajectory, scheme=scheme))

    def _met(self, poses: np.ndarray) -> MetObstacle | None:
        """The obstacle, among those that are not chosen, which poses, shape (m, 4), meet first."""
        if self._everything:
            return None
        others = with_obstacles(self._whole.scene, ~self._chosen)
        number = first_met(others, poses, self._problem.settings.clearance_margin)
        return None if number is None else MetObstacle(number)


def _attaining(whole: Problem, problem: Problem, profile: Profile, solver: AxisSolver) -> Candidate | None:
    """The best of the routes that attain the lower bound; None when none of those tried does."""
    remaining = best_of_branches(_attaining_routes(whole, problem, profile, solver), TIE_TOLERANCE)
    while remaining:
        best = preferred(remaining)
        trajectory = best.solution.trajectory
        residuals = verify(problem.scene, problem.settings, trajectory, problem.start, problem.initial_velocity)
        if rejection(residuals) is None:
            return best._replace(solution=best.solution._replace(residuals=residuals))
        remaining = [candidate for candidate in remaining if candidate.branch != best.branch]
    return None


def _attaining_routes(whole: Problem, problem: Problem, profile: Profile, solver: AxisSolver) -> list[Candidate]:
    """The solutions along routes that attain the lower bound and that none found before beats."""
    found: list[Candidate] = []
    least, weight = np.inf, problem.settings.effort_weight
    detours: list[Route] = []  # they need a search each, so that the others go first

    def attempt(route: Route) -> float:
        rival = (least * (1 + TIE_TOLERANCE) - profile.duration) / weight
        attained = solve_certified(Task(solver, problem, route, profile), rival)
        if attained is None:
            return np.inf
        objective = profile.duration + weight * attained.effort
        # With the rest at both ends of the paper's u_0 = u_N = 0.
        waiting = float(attained.trajectory.times[-1]) - profile.duration
        solution = RouteSolution(attained.trajectory, objective + waiting, UNKNOWN, CERTIFIED)
        found.append(_candidate(whole, route, solution))
        return objective

    search = RouteSearch(make_free_space(problem), problem, profile)
    for _ in range(FAST_ROUTES):
        route = search.next(least * (1 + TIE_TOLERANCE))
        if route is None:
            break
        if any(face.axis != profile.axis for face in route.crossed):
            detours.append(route)
        else:
            least = min(least, attempt(route))
    for route in detours:
        if route.objective_bound <= least * (1 + TIE_TOLERANCE):
            least = min(least, attempt(route))
    return found


def _candidate(whole: Problem, route: Route, solution: RouteSolution) -> Candidate:
    return Candidate(branch_name(whole.scene, solution.trajectory.states[:, :POSE_SIZE]), route.detours, solution)
