"""Solving one start to global quality: every route that could be best, each verified, the best kept."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agile_jax.expert.minimum_time import lower_bound
from agile_jax.expert.regions import FreeSpace, check_target, make_free_space
from agile_jax.expert.routes import Route, branch_name, branch_rank, find_routes
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import ExpertSolution, Residuals, Trajectory
from agile_jax.expert.verify import rejection, verify
from agile_jax.scene import POSE_SIZE, Scene

TIE = 1e-6  # relative difference of objectives below which the fixed order of branches decides
# Several routes can describe one path (a start that is in front of the table and beside it may leave either region
# first). Their objectives then differ by the placing of the nodes alone, and the route pinned along the main motion
# is the better conditioned one.
GRID = 5e-4  # relative
FEWEST_INTERVALS = 4  # in a phase
NO_ROUTE = "no route: start or target is not free for the torso's footprint over this yaw, or nothing connects them"
SHORTEST = 0.1  # [s] the least duration by which the gap is made relative


class Candidate(NamedTuple):
    """A verified trajectory along one route."""

    branch: str
    detours: int
    trajectory: Trajectory
    objective: float
    residuals: Residuals


class Expert(NamedTuple):
    """`solve` is a pure function of its arguments; the solvers that it builds on first use hold no state between
    calls."""

    solve: Callable[..., ExpertSolution]


def make_expert(scene: Scene, settings: ExpertSettings) -> Expert:
    """The expert for a scene.

    Returns: Expert whose `solve(start, initial_velocity=None, solver="fatrop")` takes a pose, shape (4,) [m, rad],
        and returns an `ExpertSolution`; it does not raise for a start without solution (status "failed").
        `check_start` refuses bad starts.

    Raises:
        BadInput: the target keeps less than the margin.
    """
    check_target(scene, settings)
    programs: dict[tuple[int, str, str], Any] = {}

    def program(phases: int, initial_velocity: str, solver: str) -> Any:
        # CasADi is loaded by the first solve: settings, verification and free space are read without it.
        from agile_jax.expert.transcription import build_program

        key = (phases, initial_velocity, solver)
        if key not in programs:
            programs[key] = build_program(phases, initial_velocity, settings, solver)
        return programs[key]

    def solve_route(
        space: FreeSpace, route: Route, start: np.ndarray, initial_velocity: str, solver: str
    ) -> Candidate | str:
        """The verified solution along a route, or why there is none. The other solver tries what the first cannot."""
        from agile_jax.expert.transcription import make_arguments, solve_program

        if settings.nodes < FEWEST_INTERVALS * len(route.regions):
            return f"{settings.nodes} nodes are too few for {len(route.regions)} phases"
        causes = []
        for name in (solver, "ipopt" if solver == "fatrop" else "fatrop"):
            chosen = program(len(route.regions), initial_velocity, name)
            arguments = make_arguments(route, chosen, start, scene.target, settings)
            trajectory, objective, success, status = solve_program(chosen, arguments)
            residuals = verify(scene, settings, trajectory, start, initial_velocity)
            cause = rejection(residuals)
            if success and not cause:
                branch = branch_name(space, route, trajectory.states[:, :POSE_SIZE])
                return Candidate(branch, route.detours, trajectory, objective, residuals)
            causes.append(f"{name}: " + (cause if success else f"status {status}"))
        return "; ".join(causes)

    def solve(start: Any, initial_velocity: str | None = None, solver: str = "fatrop") -> ExpertSolution:
        began = time.perf_counter()
        start = np.asarray(start, float)
        condition = initial_velocity or settings.initial_velocity
        bound = lower_bound(start, scene.target, settings, condition)
        best: dict[str, Candidate] = {}  # by branch
        least = np.inf
        solved: list[tuple[str, float]] = []
        causes: list[str] = []
        space = make_free_space(scene, settings, start)
        routes = find_routes(space, start, scene.target, settings, condition)
        for tried, route in enumerate(routes):
            if tried == settings.max_routes or route.objective_bound > least * (1 + TIE):
                break
            candidate = solve_route(space, route, start, condition, solver)
            if isinstance(candidate, str):
                causes.append(f"{len(route.regions)} phases: {candidate}")
                continue
            solved.append((candidate.branch, candidate.objective))
            least = min(least, candidate.objective)
            rival = best.get(candidate.branch)
            if rival is None or _better(candidate, rival):
                best[candidate.branch] = candidate
        seconds = time.perf_counter() - began
        if not best:
            cause = "not solved: " + "; ".join(causes) if causes else NO_ROUTE
            return failed_solution(settings, bound, cause, seconds)
        return _solution(_choose(list(best.values())), bound, solved, seconds)

    return Expert(solve)


def _solution(best: Candidate, bound: float, solved: list[tuple[str, float]], seconds: float) -> ExpertSolution:
    duration = float(best.trajectory.times[-1])
    return ExpertSolution(
        trajectory=best.trajectory,
        duration=duration,
        lower_bound=bound,
        gap=(duration - bound) / max(bound, SHORTEST),
        branch=best.branch,
        objective=best.objective,
        status="solved",
        cause="",
        **best.residuals._asdict(),
        routes=tuple(solved),
        solve_time_s=seconds,
    )


def failed_solution(settings: ExpertSettings, bound: float, cause: str, seconds: float) -> ExpertSolution:
    """A solution without trajectory, that says why."""
    empty = Trajectory(
        np.zeros(settings.nodes + 1),
        np.zeros((settings.nodes + 1, 2 * POSE_SIZE)),
        np.zeros((settings.nodes, POSE_SIZE)),
    )
    zeros = Residuals(0.0, 0.0, 0.0, 0.0, 0.0)
    return ExpertSolution(empty, 0.0, bound, 0.0, "", 0.0, "failed", cause, *zeros, (), seconds)


def _better(candidate: Candidate, rival: Candidate) -> bool:
    """Whether a candidate describes their common branch better."""
    if abs(candidate.objective - rival.objective) <= GRID * rival.objective and candidate.detours != rival.detours:
        return candidate.detours < rival.detours
    return candidate.objective < rival.objective


def _choose(candidates: list[Candidate]) -> Candidate:
    """The best branch by the objective; within the tie the fixed order decides."""
    least = min(candidate.objective for candidate in candidates)
    tied = [candidate for candidate in candidates if candidate.objective <= least * (1 + TIE)]
    return min(tied, key=lambda candidate: branch_rank(candidate.branch))
