"""Solving one start to global quality: every route that could be best, each verified, the best kept.

The order of labels: least duration first. Among routes that attain the analytic lower bound, which no trajectory can
beat, the least effort wins; where none attains it, the least T + w E. Ties fall to the fixed order of branches.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agile_jax.expert.certified import CertifiedSolver, applies, make_certified_solver, solve_certified
from agile_jax.expert.ladder import CERTIFIED, VIOLATION, Candidate, Ladder
from agile_jax.expert.minimum_time import lower_bound
from agile_jax.expert.profile import Profile, slowest_axis
from agile_jax.expert.regions import (
    ROUNDING_ERRORS,
    TIGHTENING,
    FreeSpace,
    boxes_suffice,
    check_target,
    make_free_space,
)
from agile_jax.expert.routes import Route, branch_name, branch_rank, find_routes
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import ExpertSolution, Residuals, Trajectory
from agile_jax.expert.turns import split_turns
from agile_jax.expert.verify import rejection, verify
from agile_jax.scene import POSE_SIZE, Scene, planar_scene

TIE = 1e-6  # relative difference of objectives below which the fixed order of branches decides
# Several routes can describe one path (a start that is in front of the table and beside it may leave either region
# first). Their objectives then differ by the placing of the nodes alone, and the route pinned along the main motion
# is the better conditioned one.
GRID = 5e-4  # relative
ATTAINED = 1e-4  # relative excess over the lower bound below which a duration is the least
NO_ROUTE = "no route: start or target is not free, or nothing connects them"
SHORTEST = 0.1  # [s] the least duration by which the gap is made relative


class Expert(NamedTuple):
    """`solve` is a pure function of its arguments; the solvers that it builds on first use hold no state between
    calls."""

    solve: Callable[..., ExpertSolution]


def make_expert(scene: Scene, settings: ExpertSettings) -> Expert:
    """The expert for a scene.

    Returns: Expert whose `solve(start, initial_velocity=None, first="fatrop", guess=0)` takes a pose, shape (4,),
        and returns an `ExpertSolution`; it does not raise for a start without solution (status "failed"). `first` names
        the rung of the ladder to begin with (ladder.py), `guess` one of its initial guesses; labels must not depend
        on either. `check_start` refuses bad starts. With planner "2d" the
        start's height is replaced by the target's.

    Raises:
        BadInput: the target keeps less than the margin.
    """
    if settings.planner == "2d":
        scene = planar_scene(scene)
    check_target(scene, settings)
    ladder = Ladder(scene, settings)
    certified: dict[str, CertifiedSolver] = {}

    def fast(start: np.ndarray, condition: str, space: FreeSpace, profile: Profile) -> Candidate | None:
        """The best of the routes that attain the lower bound; None when none of those tried does."""
        if condition not in certified:
            certified[condition] = make_certified_solver(settings, condition)
        found: list[tuple[Route, Trajectory, float]] = []
        least = np.inf
        detours: list[Route] = []  # they need a search each, so that the others go first

        def attempt(route: Route) -> float:
            rival = (least - profile.duration) / settings.effort_weight
            attained = solve_certified(certified[condition], route, profile, start, scene.target, rival)
            if attained is None:
                return np.inf
            trajectory, effort = attained
            objective = profile.duration + settings.effort_weight * effort
            found.append((route, trajectory, objective))
            return objective

        for tried, route in enumerate(find_routes(space, start, scene.target, settings, condition)):
            if tried == settings.max_routes or route.objective_bound > least * (1 + TIE):
                break
            if route.duration_bound > profile.duration * (1 + TIE):
                continue
            if any(pin.axis != profile.axis for pin in route.pins):
                detours.append(route)
            else:
                least = min(least, attempt(route))
        for route in detours:
            if route.objective_bound <= least * (1 + TIE):
                least = min(least, attempt(route))
        candidates: dict[str, Candidate] = {}
        for route, trajectory, objective in found:
            branch = branch_name(space, route, trajectory.states[:, :POSE_SIZE])
            rival = candidates.get(branch)
            candidate = Candidate(branch, route.detours, trajectory, objective, _UNKNOWN, CERTIFIED)
            if rival is None or _better(candidate, rival):
                candidates[branch] = candidate
        while candidates:
            best = _choose(list(candidates.values()))
            residuals = verify(scene, settings, best.trajectory, start, condition)
            if not rejection(residuals):
                return best._replace(residuals=residuals)
            del candidates[best.branch]
        return None

    def solve(start: Any, initial_velocity: str | None = None, first: str = "fatrop", guess: int = 0) -> ExpertSolution:
        began = time.perf_counter()
        start = np.array(start, float)
        if settings.planner == "2d":
            start[2] = scene.target[2]
        condition = initial_velocity or settings.initial_velocity
        bound = lower_bound(start, scene.target, settings, condition)
        profile = slowest_axis(start, scene.target, settings, condition)
        boxes = boxes_suffice(scene, start)
        if applies(settings):
            space = make_free_space(scene, settings, start)
            attained = fast(start, condition, space, profile)
            if attained is not None:
                solved = [(attained.branch, attained.objective)]
                return _solution(attained, bound, solved, time.perf_counter() - began)

        candidates: list[Candidate] = []
        least = np.inf
        causes: list[str] = []
        rounded = settings.edges == "rounded"
        # The larger reserve is for what leaves its bounds between nodes, and makes square edges those of the fast path.
        for reserve in (ROUNDING_ERRORS, TIGHTENING) if rounded else (TIGHTENING,):
            space = make_free_space(scene, settings, start, not boxes, reserve)
            routes = find_routes(space, start, scene.target, settings, condition, rounded)
            routes = split_turns(space, routes, start, scene.target, settings, condition)
            causes.clear()
            for tried, route in enumerate(routes):
                if tried == settings.max_routes or route.objective_bound > least * (1 + TIE):
                    break
                candidate = ladder.solve(space, route, start, condition, profile, first, guess, least)
                if isinstance(candidate, str):
                    causes.append(f"{len(route.regions)} phases: {candidate}")
                    continue
                candidates.append(candidate)
                least = min(least, candidate.objective)
            if not any(VIOLATION in cause for cause in causes):
                break
        seconds = time.perf_counter() - began
        if not candidates:
            cause = "not solved: " + "; ".join(causes) if causes else NO_ROUTE
            return failed_solution(settings, bound, cause, seconds)
        solved = [(candidate.branch, candidate.objective) for candidate in candidates]
        return _solution(_best(candidates, bound), bound, solved, seconds)

    return Expert(solve)


_UNKNOWN = Residuals(np.nan, np.nan, np.nan, np.nan, np.nan, np.nan)


def _best(candidates: list[Candidate], bound: float) -> Candidate:
    """The label among verified candidates."""
    attaining = [c for c in candidates if c.trajectory.times[-1] <= bound * (1 + ATTAINED)]
    by_branch: dict[str, Candidate] = {}
    for candidate in attaining or candidates:
        rival = by_branch.get(candidate.branch)
        if rival is None or _better(candidate, rival):
            by_branch[candidate.branch] = candidate
    return _choose(list(by_branch.values()))


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
        method=best.method,
        routes=tuple(solved),
        solve_time_s=seconds,
    )


def failed_solution(settings: ExpertSettings, bound: float, cause: str, seconds: float) -> ExpertSolution:
    """A solution without trajectory, that says why."""
    empty = Trajectory(
        np.zeros(settings.nodes + 1),
        np.zeros((settings.nodes + 1, 2 * POSE_SIZE)),
        np.zeros((settings.nodes + (settings.transcription != "zoh"), POSE_SIZE)),
    )
    zeros = Residuals(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return ExpertSolution(empty, 0.0, bound, 0.0, "", 0.0, "failed", cause, *zeros, "", (), seconds)


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
