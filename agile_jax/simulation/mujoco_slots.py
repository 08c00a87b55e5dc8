"""Closed-loop episodes in a physics that the host steps: one compiled call controls the whole batch."""

import dataclasses
from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from agile_jax.robot import Plant, trunk_pose
from agile_jax.scene import Scene
from agile_jax.simulation.closed_loop import ClosedLoop, Episode, resume_from
from agile_jax.simulation.outcome import RUNNING
from agile_jax.simulation.paths import PathPlanner, TimedPath
from agile_jax.simulation.perception import IDEAL
from agile_jax.simulation.physics.host_physics import HostPhysics
from agile_jax.simulation.plan_cycle import on_host, plan_cycle
from agile_jax.simulation.pushes import Pushes
from agile_jax.simulation.sensed import Sensed
from agile_jax.simulation.streaming import Rollout, for_all
from agile_jax.simulation.traces import Sample, sample_of


@dataclasses.dataclass(frozen=True, eq=False)
class BatchLoop:
    """The functions of a closed loop for n robots, compiled once. `begin`, `plan` and `act` consume the episodes."""

    # (sensed, time limits [s], keys)
    first: Callable[[Sensed, Float[np.ndarray, " n"], UInt32[np.ndarray, "n 2"]], Episode]
    # (where new episodes begin, sensed, time limits [s], keys, episodes)
    begin: Callable[
        [Bool[np.ndarray, " n"], Sensed, Float[np.ndarray, " n"], UInt32[np.ndarray, "n 2"], Episode], Episode
    ]
    plan: Callable[[PyTree, TimedPath | None, Episode, Sensed], Episode]  # of which the parameters lead with no n
    act: Callable[[Episode, Sensed], Episode]
    acts_per_plan: int
    control_dt: float  # [s]
    scene: Scene
    believed_pose: Callable[[Episode, Sensed], Float[Array, "n 4"]] | None  # where it is not the true one [m, rad]


def batch_loop(loop: ClosedLoop) -> BatchLoop:
    """Compile a closed loop for batches; keep it, a second one would compile again."""
    first = jax.vmap(loop.init)

    def begin(mask: jax.Array, sensed: Sensed, limits: jax.Array, keys: jax.Array, episodes: Episode) -> Episode:
        return resume_from(mask, first(sensed, limits, keys), episodes)

    return BatchLoop(
        jax.jit(first),
        jax.jit(begin, donate_argnums=4),
        jax.jit(jax.vmap(loop.plan, in_axes=(None, 0, 0, 0)), donate_argnums=2),
        jax.jit(jax.vmap(loop.act), donate_argnums=0),
        loop.acts_per_plan,
        loop.settings.control_dt,
        loop.scene,
        None if loop.perception is IDEAL else jax.jit(jax.vmap(loop.believed_pose)),
    )


class MujocoSlots:
    """Slots in C MuJoCo or PyBullet. One advance is one plan and the control steps until the next."""

    plans_per_advance = 1

    def __init__(
        self,
        loop: BatchLoop,
        physics: HostPhysics,
        parameters: PyTree,
        planner: PathPlanner | None = None,
    ) -> None:
        """Allocate the slots.

        Args:
            loop: from `batch_loop`.
            physics: its batch is the number of slots.
            parameters: of the policy.
            planner: where the loop follows paths.
        """
        self.loop, self.physics, self.parameters, self._planner = loop, physics, parameters, planner
        self._paths: TimedPath | None = None
        self._episodes: Episode | None = None
        self._active = np.zeros(physics.batch, bool)
        self._plans = np.zeros(physics.batch, int)
        self._pushes = Pushes(loop.scene, physics.batch, loop.control_dt)

    @property
    def count(self) -> int:
        """How many episodes run at once."""
        return self.physics.batch

    def begin(
        self,
        slots: Int[np.ndarray, " k"],
        qpos: Float[np.ndarray, "k nq"],
        time_limits: Float[np.ndarray, " k"],
        plants: Plant | None = None,
        keys: UInt32[np.ndarray, "k 2"] | None = None,
    ) -> None:
        """Start new episodes in some slots, from rest at coordinates `qpos`, with time limits [s], of robots."""
        mask, limits, all_keys = for_all(self.count, slots, time_limits, keys)
        if self._episodes is None:  # slots that are still free hold copies, which are never stepped
            self._sensed = self.physics.reset(np.repeat(qpos[:1], self.count, 0))
            self._episodes = self.loop.first(self._sensed, limits, all_keys)
        self._sensed = self.physics.reset(qpos, slots, plants)
        self._pushes.reset(slots, plants)
        self._episodes = self.loop.begin(mask, self._sensed, limits, all_keys, self._episodes)
        if self._planner is not None:
            self._planner.begin(slots, trunk_pose(qpos))
        self._active |= mask
        self._plans[slots] = 0

    def advance(self) -> Int[np.ndarray, " n"]:
        """Plan once, then act until the next plan is due; the status of every slot."""
        episodes = self._episodes
        assert episodes is not None
        poses, times = trunk_pose(self._sensed.qpos), np.asarray(episodes.outcome.time, float)
        if self._pushes.waiting:
            self._pushes.plan(poses, times, self._active)
        if self._planner is not None:
            if self.loop.believed_pose is not None:
                poses = np.asarray(self.loop.believed_pose(episodes, self._sensed), float)
            self._planner.advance(poses, times, self._active)
            self._paths = self._planner.paths
        self._plans += self._active
        self._was_active = self._active.copy()
        _, following, self._sensed = plan_cycle(
            self.plan, self.loop.act, self._step, None, episodes, self._sensed, self.loop.acts_per_plan, on_host
        )
        self._episodes = following
        status = np.asarray(following.outcome.status)
        self._active &= status == RUNNING
        return status

    def plan(self, episode: Episode, sensed: Sensed) -> Episode:
        """Plan in all slots."""
        return self.loop.plan(self.parameters, self._paths, episode, sensed)

    def _step(self, world: None, episode: Episode) -> tuple[None, Sensed]:
        torque, pushes = np.asarray(episode.torque, np.float64), self._pushes.forces(self._active)
        return world, self.physics.step(torque, self._active, pushes)

    def read(self, slots: Int[np.ndarray, " k"]) -> Rollout:
        """The results in some slots."""
        assert self._episodes is not None
        ended = self._episodes.outcome, self._episodes.diagnostics.counts
        outcome, counts = jax.tree.map(lambda values: np.asarray(values)[slots], ended)
        return Rollout(outcome, counts, self._plans[slots])

    def snapshot(self) -> tuple[Bool[np.ndarray, "n 1"], Sample]:
        """The states of all slots after the last plan: was it running, samples (n, 1, ...)."""
        assert self._episodes is not None
        # Copies: the memory is given to the next plan.
        sample = jax.tree.map(np.array, sample_of(self._episodes, self._sensed))
        return self._was_active[:, None], Sample(*(values[:, None] for values in sample))
