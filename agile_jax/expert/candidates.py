"""Which of the verified trajectories along different routes is the label.

Least duration first: among routes that attain the analytic lower bound, which no trajectory can beat, the least effort
wins; where none attains it, the least T + w E. Ties fall to the fixed order of branches.
"""

from collections.abc import Iterable
from typing import NamedTuple

from agile_jax.expert.programs.retries import RouteSolution
from agile_jax.expert.search.branches import branch_rank

TIE_TOLERANCE = 1e-6  # relative difference of objectives below which the fixed order of branches decides
# Several routes can describe one path (a start that is in front of the table and beside it may leave either region
# first). Their objectives then differ by the placing of the nodes alone, and the route that crosses along the main
# motion is the better conditioned one.
GRID_TOLERANCE = 5e-4  # relative
ATTAINED = 1e-4  # relative excess over the lower bound below which a duration is the least


class Candidate(NamedTuple):
    """A solution along one route."""

    branch: str
    detours: int  # of the route
    solution: RouteSolution

    @property
    def objective(self) -> float:
        """T + w E."""
        return self.solution.objective


def label_of(candidates: Iterable[Candidate], bound: float) -> Candidate:
    """The label among verified candidates; `bound` is the lower bound on its duration [s]."""
    candidates = list(candidates)
    attaining = [c for c in candidates if c.solution.trajectory.times[-1] <= bound * (1 + ATTAINED)]
    return preferred(best_of_branches(attaining or candidates))


def best_of_branches(candidates: Iterable[Candidate], tolerance: float = GRID_TOLERANCE) -> list[Candidate]:
    """One candidate of each branch: of objectives that agree to the relative tolerance, the one with fewest detours."""
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        rival = best.get(candidate.branch)
        if rival is None or _better(candidate, rival, tolerance):
            best[candidate.branch] = candidate
    return list(best.values())


def preferred(candidates: list[Candidate]) -> Candidate:
    """The best by the objective; within the tie the fixed order of branches decides."""
    least = min(candidate.objective for candidate in candidates)
    tied = [candidate for candidate in candidates if candidate.objective <= least * (1 + TIE_TOLERANCE)]
    return min(tied, key=lambda candidate: branch_rank(candidate.branch))


def _better(candidate: Candidate, rival: Candidate, tolerance: float) -> bool:
    close = abs(candidate.objective - rival.objective) <= tolerance * rival.objective
    if close and candidate.detours != rival.detours:
        return candidate.detours < rival.detours
    return candidate.objective < rival.objective
