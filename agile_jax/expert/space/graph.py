"""The graph of regions: which of them there are, and how to get from one to another."""

from collections.abc import Iterable, Sequence

from agile_jax.expert.problem import Problem
from agile_jax.expert.space.crossings import find_crossings
from agile_jax.expert.space.edges import Passage, round_edge
from agile_jax.expert.space.regions import Choice, FreeSpace, Region, holds, make_region


class Graph:
    """Regions and the crossings between them, made when they are first asked for."""

    def __init__(self, space: FreeSpace, priority: Sequence[int], problem: Problem, rounded: bool) -> None:
        self._space, self._priority, self._target = space, priority, problem.target
        self._rounded = (problem.start, problem.target) if rounded else None
        self.regions: dict[Choice, Region] = {}
        self._empty: set[Choice] = set()
        self._holding_target: dict[Choice, bool] = {}
        self._neighbours: dict[Choice, dict[Choice, list[Passage]]] = {}

    def neighbours(self, choice: Choice) -> dict[Choice, list[Passage]]:
        """Regions that differ in the cell of one obstacle, in a fixed order, with the passages to them."""
        if choice not in self._neighbours:
            found = {}
            for obstacle, cell in enumerate(choice):
                for other in range(len(self._space.cells[obstacle])):
                    there = (*choice[:obstacle], other, *choice[obstacle + 1 :])
                    if other != cell and self._exists(there):
                        passages = self._passages(obstacle, self.regions[choice], self.regions[there])
                        if passages:
                            found[there] = passages
            self._neighbours[choice] = dict(sorted(found.items()))
        return self._neighbours[choice]

    def _passages(self, obstacle: int, before: Region, after: Region) -> list[Passage]:
        """The ways from one region to another that differs in the cell of one obstacle; with rounded edges, where
        these have one."""
        passages = []
        for crossing in find_crossings(self._space, obstacle, before, after, self._priority):
            around = None
            if self._rounded is not None:
                around = round_edge(self._space, obstacle, before, after, crossing.face, self._rounded)
            passages.append(around or Passage((crossing,)))
        return passages

    def holds_target(self, choice: Choice) -> bool:
        """Whether a region holds the target."""
        if choice not in self._holding_target:
            self._holding_target[choice] = holds(self._space, self.regions[choice], self._target)
        return self._holding_target[choice]

    def connects(self, starts: Iterable[Choice]) -> bool:
        """Whether any sequence of neighbours leads from one of the regions to one that holds the target."""
        seen = set(starts)
        waiting = list(seen)
        while waiting:
            choice = waiting.pop()
            if self.holds_target(choice):
                return True
            fresh = [there for there in self.neighbours(choice) if there not in seen]
            seen.update(fresh)
            waiting += fresh
        return False

    def _exists(self, choice: Choice) -> bool:
        if choice not in self.regions and choice not in self._empty:
            region = make_region(self._space, choice)
            if region is None:
                self._empty.add(choice)
            else:
                self.regions[choice] = region
        return choice in self.regions
