"""Closed-loop episodes in MJX: policy, controller, physics and outcome in one compiled scan, vmapped over robots.

Over several devices each simulates its share of the robots; nothing passes between them.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Bool, Float, Int, PyTree, UInt32

from agile_jax.robot import Plant
from agile_jax.simulation.closed_loop import ClosedLoop, Episode, resume_from
from agile_jax.simulation.outcome import RUNNING
from agile_jax.simulation.physics.mjx_physics import MjxModel, mjx, mjx_reset, mjx_step
from agile_jax.simulation.plan_cycle import compiled, plan_cycle
from agile_jax.simulation.sensed import Sensed
from agile_jax.simulation.streaming import Rollout, for_all
from agile_jax.simulation.traces import Sample, sample_of

SEGMENT = 10  # plans between two looks at who has ended


class MjxState(NamedTuple):
    """One robot in MJX and its loop."""

    data: mjx.Data
    episode: Episode
    sensed: Sensed
    plans: Int[Array, ""]  # made in this episode


Recorded = tuple[Bool[Array, "..."], Sample]  # was it running, samples: of each plan


@dataclasses.dataclass(frozen=True, eq=False)
class MjxLoop:
    """Compiled functions of n robots, a multiple of the number of devices; compiled anew for each n."""

    # (qpos, time limits [s], keys)
    first: Callable[[Float[np.ndarray, "n nq"], Float[np.ndarray, " n"], UInt32[np.ndarray, "n 2"]], MjxState]
    # (where new episodes begin, qpos, time limits [s], keys, states, which it consumes)
    begin: Callable[
        [
            Bool[np.ndarray, " n"],
            Float[np.ndarray, "n nq"],
            Float[np.ndarray, " n"],
            UInt32[np.ndarray, "n 2"],
            MjxState,
        ],
        MjxState,
    ]
    # (policy parameters, states, which it consumes) -> states a segment later, and what was on the way
    advance: Callable[[PyTree, MjxState], tuple[MjxState, Recorded]]
    devices: int


@dataclasses.dataclass(frozen=True, eq=False)
class MjxEpisode:
    """The functions of one robot that `mjx_loop` compiles for many."""

    loop: ClosedLoop
    model: MjxModel

    def init(self, qpos: Float[Array, " nq"], limit: Float[Array, ""], key: UInt32[Array, "2"]) -> MjxState:
        """Begin an episode at rest at coordinates `qpos`, with a time limit [s]; `key` is of what is random."""
        nothing = jnp.bool_(False)
        sensed = Sensed(qpos, jnp.zeros(self.model.model.nv, qpos.dtype), nothing, nothing, jnp.zeros(4, bool))
        return MjxState(mjx_reset(self.model, qpos), self.loop.init(sensed, limit, key), sensed, jnp.int32(0))

    def begin(
        self,
        mask: Bool[Array, " n"],
        qpos: Float[Array, "n nq"],
        limits: Float[Array, " n"],
        keys: UInt32[Array, "n 2"],
        states: MjxState,
    ) -> MjxState:
        """Begin new episodes where `mask` is set, of many robots."""
        return resume_from(mask, jax.vmap(self.init)(qpos, limits, keys), states)

    def advance(self, parameters: PyTree, state: MjxState) -> tuple[MjxState, Recorded]:
        """A segment of plans."""
        return jax.lax.scan(lambda carry, _: self._one_plan(parameters, carry), state, None, length=SEGMENT)

    def _one_plan(self, parameters: PyTree, state: MjxState) -> tuple[MjxState, Recorded]:
        running = state.episode.outcome.status == RUNNING
        data, episode, sensed = plan_cycle(
            partial(self.loop.plan, parameters, None),
            self.loop.act,
            lambda data, episode: mjx_step(self.model, data, episode.torque),
            state.data,
            state.episode,
            state.sensed,
            self.loop.acts_per_plan,
            compiled,
        )
        return MjxState(data, episode, sensed, state.plans + running), (running, sample_of(episode, sensed))


def mjx_loop(loop: ClosedLoop, model: MjxModel, devices: int = 1) -> MjxLoop:
    """Compile a closed loop with its physics; keep it, a second one would compile again.

    Args:
        loop: of one robot.
        model: from `mjx_init`.
        devices: how many of JAX's devices share the robots.
    """
    one = MjxEpisode(loop, model)
    mesh = Mesh(np.array(jax.devices()[:devices]), ("robots",))
    robots, everywhere = PartitionSpec("robots"), PartitionSpec()
    first = jax.shard_map(jax.vmap(one.init), mesh=mesh, in_specs=(robots,) * 3, out_specs=robots, check_vma=False)
    begin = jax.shard_map(one.begin, mesh=mesh, in_specs=(robots,) * 5, out_specs=robots, check_vma=False)
    advance = jax.shard_map(
        jax.vmap(one.advance, in_axes=(None, 0)),
        mesh=mesh,
        in_specs=(everywhere, robots),
        out_specs=robots,
        check_vma=False,
    )
    return MjxLoop(jax.jit(first), jax.jit(begin, donate_argnums=4), jax.jit(advance, donate_argnums=1), devices)


class MjxSlots:
    """Slots in MJX. One advance is a segment of plans on the device."""

    plans_per_advance = SEGMENT

    def __init__(self, loop: MjxLoop, count: int, parameters: PyTree) -> None:
        """Args: loop: from `mjx_loop`; count: of the slots, at least; parameters: of the policy."""
        self._loop, self._parameters = loop, parameters
        self._count = -(-count // loop.devices) * loop.devices
        self._states: MjxState | None = None

    @property
    def count(self) -> int:
        """How many episodes run at once."""
        return self._count

    def begin(
        self,
        slots: Int[np.ndarray, " k"],
        qpos: Float[np.ndarray, "k nq"],
        time_limits: Float[np.ndarray, " k"],
        plants: Plant | None = None,
        keys: UInt32[np.ndarray, "k 2"] | None = None,
    ) -> None:
        """Start new episodes in some slots, from rest at coordinates `qpos`, with time limits [s].

        All robots have the model of the loop, so there are no `plants`.
        """
        assert plants is None
        all_qpos = np.repeat(np.asarray(qpos[:1], np.float32), self._count, 0)
        all_qpos[slots] = qpos
        mask, limits, all_keys = for_all(self._count, slots, time_limits, keys)
        if self._states is None:
            self._states = self._loop.first(all_qpos, limits, all_keys)
        else:
            self._states = self._loop.begin(mask, all_qpos, limits, all_keys, self._states)

    def advance(self) -> Int[np.ndarray, " count"]:
        """Simulate a segment; the status of every slot."""
        assert self._states is not None
        self._states, (self._running, self._samples) = self._loop.advance(self._parameters, self._states)
        return np.asarray(self._states.episode.outcome.status)

    def read(self, slots: Int[np.ndarray, " k"]) -> Rollout:
        """The results in some slots."""
        assert self._states is not None
        episode, plans = self._states.episode, np.asarray(self._states.plans)
        ended = episode.outcome, episode.diagnostics.counts
        outcome, counts = jax.tree.map(lambda values: np.asarray(values)[slots], ended)
        return Rollout(outcome, counts, plans[slots])

    def snapshot(self) -> tuple[Bool[np.ndarray, "count segment"], Sample]:
        """The states of all slots after each plan of the last segment, still on the device."""
        return np.asarray(self._running), self._samples
