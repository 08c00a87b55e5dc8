"""Solving one start to global quality: every route that could be best, each verified, the best kept.

The order of labels: least duration first. Among routes that attain the analytic lower bound, which no trajectory can
beat, the least effort wins; where none attains it, the least T + w E. Ties fall to the fixed order of branches.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np

from agile_jax import plugins
from agile_jax.expert.feasible_poses import check_target
from agile_jax.expert.own import FindPath, OwnExpert
from agile_jax.expert.programs.certified import CertifiedSolver, Task, applies, make_certified_solver, solve_certified
from agile_jax.expert.programs.retries import CERTIFIED, VIOLATION, Candidate, Ladder
from agile_jax.expert.search.branches import branch_name, branch_rank
from agile_jax.expert.search.minimum_time import lower_bound
from agile_jax.expert.search.profile import Profile, slowest_axis
from agile_jax.expert.search.routes import Route, RouteSearch, waypoints
from agile_jax.expert.search.turns import split_turns
from agile_jax.expert.settings import EXPERTS, ExpertSettings
from agile_jax.expert.solution import ExpertSolution, Residuals, Trajectory, failed_solution
from agile_jax.expert.space.nearby_obstacles import along, first_met, first_obstacles, with_obstacles
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
from agile_jax.scene import POSE_SIZE, Scene, facing, planar_scene

TIE = 1e-6  # relative difference of objectives below which the fixed order of branches decides
# Several routes can describe one path (a start that is in front of the table and beside it may leave either region
# first). Their objectives then differ by the placing of the nodes alone, and the route pinned along the main motion
# is the better conditioned one.
GRID = 5e-4  # relative
FAST_ROUTES = 200  # looked at by the fast path at most
ATTAINED = 1e-4  # relative excess over the lower bound below which a duration is the least
NO_ROUTE = "no route: start or target is not free, or nothing connects them"
SHORTEST = 0.1  # [s] the least duration by which the gap is made relative


class Expert(NamedTuple):
    """`solve` is a pure function of its arguments; the solvers that it builds on first use hold no state between
    calls."""

    solve: Callable[..., ExpertSolution]


def make_expert(scene: Scene, settings: ExpertSettings) -> Expert:
    """The expert for a scene.

    Returns: Expert whose `solve(start, initial_velocity=None, first="fatrop", guess=0, target=None)` takes poses,
        shape (4,), and returns an `ExpertSolution`; without `target` it leads to the scene's. It does not raise where
        there is no solution (status "failed"). `first` names the rung of the ladder to begin with (ladder.py), `guess`
        one of its initial guesses; labels must not depend on either. `check_start` and `check_target` refuse bad poses.
        With planner "2d" the start's height is replaced by the target's. Where the bounds of yaw hold a full circle,
        the path turns the shorter way, and its last yaw may differ from the target's by full turns.

    Raises:
        BadInput: the target keeps less than the margin.
    """
    if settings.kind not in EXPERTS:
        find_path = cast(FindPath, plugins.find("expert", settings.kind)(scene, settings))
        return Expert(OwnExpert(scene, settings, find_path).solve)
    flat = settings.dimensions == "2d"
    check_target(planar_scene(scene) if flat else scene, settings)
    ladder = Ladder(scene.torso_half_size, settings)
    certified: dict[str, CertifiedSolver] = {}

    def fast(
        world: Scene, scene: Scene, start: np.ndarray, condition: str, space: FreeSpace, profile: Profile
    ) -> Candidate | None:
        """The best of the routes that attain the lower bound; None when none of those tried does."""
        if condition not in certified:
            certified[condition] = make_certified_solver(settings, condition)
        found: list[tuple[Route, Trajectory, float]] = []
        least = np.inf
        detours: list[Route] = []  # they need a search each, so that the others go first

        def attempt(route: Route) -> float:
            rival = (least * (1 + TIE) - profile.duration) / settings.effort_weight
            attained = solve_certified(Task(certified[condition], route, profile, start, scene.target), rival)
            if attained is None:
                return np.inf
            trajectory, effort = attained
            objective = profile.duration + settings.effort_weight * effort
            found.append((route, trajectory, objective))
            return objective

        search = RouteSearch(space, start, scene.target, settings, condition, profile)
        for _ in range(FAST_ROUTES):
            route = search.next(least * (1 + TIE))
            if route is None:
                break
            if any(pin.axis != profile.axis for pin in route.pins):
                detours.append(route)
            else:
                least = min(least, attempt(route))
        for route in detours:
            if route.objective_bound <= least * (1 + TIE):
                least = min(least, attempt(route))
        candidates: dict[str, Candidate] = {}
        for route, trajectory, objective in found:
            branch = branch_name(world, trajectory.states[:, :POSE_SIZE])
            rival = candidates.get(branch)
            objective += float(trajectory.times[-1]) - profile.duration  # with the rest at both ends
            candidate = Candidate(branch, route.detours, trajectory, objective, _UNKNOWN, CERTIFIED)
            if rival is None or _better(candidate, rival, TIE):
                candidates[branch] = candidate
        while candidates:
            best = _choose(list(candidates.values()))
            residuals = verify(scene, settings, best.trajectory, start, condition)
            if not rejection(residuals):
                return best._replace(residuals=residuals)
            del candidates[best.branch]
        return None

    def solve(
        start: Any, initial_velocity: str | None = None, first: str = "fatrop", guess: int = 0, target: Any = None
    ) -> ExpertSolution:
        began = time.perf_counter()
        start = np.array(start, float)
        problem = scene if target is None else scene._replace(target=np.array(target, float))
        if flat:
            problem = planar_scene(problem)
            start[2] = problem.target[2]
        problem = facing(problem, start)
        condition = initial_velocity or settings.initial_velocity
        chosen = first_obstacles(problem, start, planning_margin(settings))
        while True:
            solution = solve_among(problem, chosen, start, condition, first, guess)
            if isinstance(solution, ExpertSolution):
                return solution._replace(solve_time_s=time.perf_counter() - began)
            chosen = chosen | (problem.obstacle_numbers == solution)

    def solve_among(
        world: Scene, chosen: np.ndarray, start: np.ndarray, condition: str, first: str, guess: int
    ) -> ExpertSolution | int:
        """The solution of one start among the chosen obstacles, (n,) bool, or the number of another one that it meets.

        Where it takes the general program, its first path, or the straight lines along it, decide what it meets.
        """
        everything = bool(chosen.all())
        scene = world if everything else with_obstacles(world, chosen)
        bound = lower_bound(start, scene.target, settings, condition)
        profile = slowest_axis(start, scene.target, settings, condition)
        boxes = boxes_suffice(scene, start)

        def met(poses: np.ndarray) -> int | None:
            return first_met(with_obstacles(world, ~chosen), poses, settings.clearance_margin)

        def met_by(candidate: Candidate) -> int | None:
            return None if everything else met(dense_poses(candidate.trajectory, scheme=settings.transcription))

        def solution(best: Candidate, solved: list[tuple[str, float]]) -> ExpertSolution | int:
            other = met_by(best)
            if other is not None:
                return other
            if not everything:
                best = best._replace(residuals=verify(world, settings, best.trajectory, start, condition))
            return _solution(best, bound, solved)

        if applies(settings, condition):
            space = make_free_space(scene, settings, start)
            attained = fast(world, scene, start, condition, space, profile)
            if attained is not None:
                return solution(attained, [(attained.branch, attained.objective)])

        candidates: list[Candidate] = []
        least = np.inf
        causes: list[str] = []

        def most() -> float:
            return least * (1 + TIE)

        rounded = settings.edges == "rounded"
        # The larger reserve is for what leaves its bounds between nodes, and makes square edges those of the fast path.
        for reserve in (ROUNDING_ERRORS, TIGHTENING) if rounded else (TIGHTENING,):
            space = make_free_space(scene, settings, start, not boxes, reserve)
            if boxes and not regions_around(space, start):  # it is nearer to a margin than the room that yaw gets
                space = make_free_space(scene, settings, start, True, reserve)
            search = RouteSearch(space, start, scene.target, settings, condition, rounded=rounded)
            routes = search.routes(most)
            causes.clear()
            for tried, route in enumerate(split_turns(space, routes, start, scene.target, settings, condition)):
                if tried == settings.max_routes or route.objective_bound > most():
                    break
                if not (everything or candidates or causes):
                    sketch = along(waypoints(route, start, scene.target))
                    if (other := met(sketch)) is not None:
                        return other
                candidate = ladder.solve(world, scene, space, route, start, condition, profile, first, guess, least)
                if isinstance(candidate, str):
                    causes.append(f"{len(route.regions)} phases: {candidate}")
                    continue
                if not candidates and (other := met_by(candidate)) is not None:
                    return other
                candidates.append(candidate)
                least = min(least, candidate.objective)
            if not any(VIOLATION in cause for cause in causes):
                break
        if not candidates:
            cause = "not solved: " + "; ".join(causes) if causes else NO_ROUTE
            return failed_solution(settings, bound, cause)
        solved = [(candidate.branch, candidate.objective) for candidate in candidates]
        return solution(_best(candidates, bound), solved)

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


def _solution(best: Candidate, bound: float, solved: list[tuple[str, float]]) -> ExpertSolution:
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
        solve_time_s=0.0,
    )


def _better(candidate: Candidate, rival: Candidate, grid: float = GRID) -> bool:
    """Whether a candidate describes their common branch better."""
    if abs(candidate.objective - rival.objective) <= grid * rival.objective and candidate.detours != rival.detours:
        return candidate.detours < rival.detours
    return candidate.objective < rival.objective


def _choose(candidates: list[Candidate]) -> Candidate:
    """The best branch by the objective; within the tie the fixed order decides."""
    least = min(candidate.objective for candidate in candidates)
    tied = [candidate for candidate in candidates if candidate.objective <= least * (1 + TIE)]
    return min(tied, key=lambda candidate: branch_rank(candidate.branch))
