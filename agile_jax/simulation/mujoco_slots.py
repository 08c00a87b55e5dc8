"""Closed-loop episodes in C MuJoCo: a thread pool steps the physics, one compiled call controls the whole batch."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.geometry import quaternion_to_rpy
from agile_jax.simulation.mujoco_physics import MujocoPhysics
from agile_jax.simulation.outcome import RUNNING
from agile_jax.simulation.paths import PathPlanner
from agile_jax.simulation.rollout import ClosedLoop, Episode, resume_from
from agile_jax.simulation.sensed import Sensed
from agile_jax.simulation.slots import Rollout
from agile_jax.simulation.traces import Sample, sample_of


class BatchLoop(NamedTuple):
    """The functions of a closed loop, vmapped and compiled once."""

    begin: Callable[..., Episode]  # (mask (n,), sensed, time limits, episodes) -> episodes, new where masked
    first: Callable[..., Episode]  # (sensed, time limits) -> episodes
    plan: Callable[..., Episode]
    act: Callable[..., Episode]
    acts_per_plan: int


def batch_loop(loop: ClosedLoop) -> BatchLoop:
    """Compile a closed loop for batches; keep it, a second one would compile again."""
    first = jax.vmap(loop.init)

    def begin(mask: jax.Array, sensed: Sensed, limits: jax.Array, episodes: Episode) -> Episode:
        return resume_from(mask, first(sensed, limits), episodes)

    return BatchLoop(
        jax.jit(begin, donate_argnums=3),
        jax.jit(first),
        jax.jit(jax.vmap(loop.plan, in_axes=(None, 0, 0, 0)), donate_argnums=2),
        jax.jit(jax.vmap(loop.act), donate_argnums=0),
        loop.acts_per_plan,
    )


class MujocoSlots:
    """Slots in C MuJoCo. One advance is one plan and the control steps until the next."""

    plans_per_advance = 1

    def __init__(
        self, loop: BatchLoop, physics: MujocoPhysics, parameters: Any, planner: PathPlanner | None = None
    ) -> None:
        """Allocate the slots.

        Args:
            loop: from `batch_loop`.
            physics: its batch is the number of slots.
            parameters: of the policy.
            planner: where the loop follows paths.
        """
        self.loop, self.physics, self.parameters, self._planner = loop, physics, parameters, planner
        self._episodes: Episode | None = None
        self._active = np.zeros(physics.batch, bool)
        self._plans = np.zeros(physics.batch, int)

    @property
    def count(self) -> int:
        """How many episodes run at once."""
        return self.physics.batch

    def begin(self, slots: np.ndarray, qpos: np.ndarray, time_limits: np.ndarray) -> None:
        """Start new episodes."""
        limits = np.zeros(self.count, np.float32)
        limits[slots] = time_limits
        mask = np.zeros(self.count, bool)
        mask[slots] = True
        if self._episodes is None:  # slots that are still free hold copies, which are never stepped
            self._sensed = self.physics.reset(np.repeat(qpos[:1], self.count, 0))
            self._episodes = self.loop.first(as_float32(self._sensed), jnp.asarray(limits))
        self._sensed = self.physics.reset(qpos, slots)
        self._episodes = self.loop.begin(mask, as_float32(self._sensed), jnp.asarray(limits), self._episodes)
        if self._planner is not None:
            self._planner.begin(slots, poses_of(qpos))
        self._active |= mask
        self._plans[slots] = 0

    def advance(self) -> np.ndarray:
        """Plan once, then act until the next plan is due."""
        assert self._episodes is not None
        paths: Any = ()
        if self._planner is not None:
            times = np.asarray(self._episodes.outcome.time, float)
            self._planner.advance(poses_of(self._sensed.qpos), times, self._active)
            paths = self._planner.paths
        episodes = self.loop.plan(self.parameters, paths, self._episodes, as_float32(self._sensed))
        self._plans += self._active
        self._was_active = self._active.copy()
        for _ in range(self.loop.acts_per_plan):
            episodes = self.loop.act(episodes, as_float32(self._sensed))
            self._sensed = self.physics.step(np.asarray(episodes.torque, np.float64), self._active)
        self._episodes = episodes
        status = np.asarray(episodes.outcome.status)
        self._active &= status == RUNNING
        return status

    def read(self, slots: np.ndarray) -> Rollout:
        """The results in some slots."""
        assert self._episodes is not None
        outcome = jax.tree.map(lambda values: np.asarray(values)[slots], self._episodes.outcome)
        counts = jax.tree.map(lambda values: np.asarray(values)[slots], self._episodes.controller.diagnostics.counts)
        return Rollout(outcome, counts, self._plans[slots])

    def snapshot(self) -> tuple[np.ndarray, Sample]:
        """The states of all slots after the last plan: was it running (count, 1), samples (count, 1, ...)."""
        assert self._episodes is not None
        # Copies: the memory is given to the next plan.
        sample = jax.tree.map(np.array, sample_of(self._episodes, self._sensed))
        return self._was_active[:, None], Sample(*(values[:, None] for values in sample))

    def samples(self, slot: int) -> list[Sample]:
        """The state of one slot after the last plan."""
        assert self._episodes is not None
        batch = sample_of(self._episodes, self._sensed)
        return [Sample(*(np.array(np.asarray(values)[slot]) for values in batch))]


def poses_of(qpos: np.ndarray) -> np.ndarray:
    """[x, y, z, yaw] of the trunk, shape (n, 4), at coordinates (n, nq)."""
    return np.concatenate([qpos[:, :3], quaternion_to_rpy(qpos[:, 3:7])[:, 2:]], -1)


def as_float32(sensed: Sensed) -> Sensed:
    """The controller's precision."""
    return Sensed(
        jnp.asarray(sensed.qpos, jnp.float32),
        jnp.asarray(sensed.qvel, jnp.float32),
        jnp.asarray(sensed.obstacle_contact),
        jnp.asarray(sensed.floor_contact),
        jnp.asarray(sensed.foot_contact),
    )
