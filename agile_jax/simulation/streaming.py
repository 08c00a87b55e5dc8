"""Many episodes through a fixed number of slots: as soon as one ends, the next begins in its place.

No slot waits for the longest of its neighbours, memory does not grow with the number of episodes, and there is one
compilation. Episodes do not know of each other: results depend neither on the number of slots nor on which one an
episode gets.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

from agile_jax.control import Counts
from agile_jax.robot import Plant
from agile_jax.simulation.outcome import RUNNING, Outcome


class Rollout(NamedTuple):
    """What n episodes ended with."""

    outcome: Outcome  # leading axis n
    counts: Counts  # of the controller, leading axis n
    plans: Int[np.ndarray, " n"]  # made in each episode


@runtime_checkable
class Slots(Protocol):
    """A batch of running episodes in some physics."""

    @property
    def count(self) -> int:
        """How many episodes run at once."""

    def begin(
        self,
        slots: Int[np.ndarray, " k"],
        qpos: Float[np.ndarray, "k nq"],
        time_limits: Float[np.ndarray, " k"],
        plants: Plant | None = None,
        keys: UInt32[np.ndarray, "k 2"] | None = None,
    ) -> None:
        """Start new episodes in some slots.

        Args:
            slots: k of them.
            qpos: from rest at these coordinates.
            time_limits: [s].
            plants: the robots.
            keys: of what is random in the episodes; without them all are (0, 0).
        """

    def advance(self) -> Int[np.ndarray, " count"]:
        """Simulate a while; return the status of every slot. What has ended does not change."""

    def read(self, slots: Int[np.ndarray, " k"]) -> Rollout:
        """The results in some slots."""


def for_all(
    count: int,
    slots: Int[np.ndarray, " k"],
    time_limits: Float[np.ndarray, " k"],
    keys: UInt32[np.ndarray, "k 2"] | None,
) -> tuple[Bool[np.ndarray, " count"], Float[np.ndarray, " count"], UInt32[np.ndarray, "count 2"]]:
    """What some slots begin with, as arrays for all of them: which begin, time limits [s] and keys."""
    mask, limits, all_keys = np.zeros(count, bool), np.zeros(count, np.float32), np.zeros((count, 2), np.uint32)
    mask[slots], limits[slots] = True, time_limits
    if keys is not None:
        all_keys[slots] = keys
    return mask, limits, all_keys


def stream(
    slots: Slots,
    qpos: Float[np.ndarray, "n nq"],
    time_limits: Float[np.ndarray, " n"],
    watch: Callable[[np.ndarray], None] | None = None,
    plants: Plant | None = None,
    keys: UInt32[np.ndarray, "n 2"] | None = None,
) -> Iterator[tuple[np.ndarray, Rollout]]:
    """Run n episodes and yield them as they end.

    Args:
        slots: where they run.
        qpos: initial configurations.
        time_limits: [s].
        watch: called after every advance with the episode in each slot, shape (count,), -1 where there is none.
        plants: the n robots; by default they are as the slots' model says.
        keys: of what is random in the episodes; by default all the same.

    Yields:
        Indices, shape (k,), of the episodes that have just ended, and their results.
    """
    holds = np.full(slots.count, -1)
    begun = 0
    while True:
        free = np.flatnonzero(holds < 0)[: len(qpos) - begun]
        if len(free):
            episodes = np.arange(begun, begun + len(free))
            robots = None if plants is None else plants.of(episodes)
            of_robots = None if keys is None else keys[episodes]
            slots.begin(free, qpos[episodes], time_limits[episodes], robots, of_robots)
            holds[free] = episodes
            begun += len(free)
        if (holds < 0).all():
            return
        status = slots.advance()
        if watch is not None:
            watch(holds)
        ended = np.flatnonzero((holds >= 0) & (status != RUNNING))
        if len(ended):
            yield holds[ended], slots.read(ended)
            holds[ended] = -1


def gather(count: int, stream: Iterator[tuple[np.ndarray, Rollout]]) -> Rollout:
    """All of a stream's `count` episodes in their order."""
    order: list[int] = []
    parts: list[Rollout] = []
    for episodes, rollout in stream:
        order += episodes.tolist()
        parts.append(rollout)
    position = np.argsort(order)
    if len(order) != count:
        raise ValueError(f"{len(order)} of {count} episodes ended")
    whole: Rollout = jax.tree.map(lambda *values: np.concatenate(values)[position], *parts)
    return whole
