"""Closed-loop episodes in MJX: policy, controller, physics and outcome in one compiled scan, vmapped over robots.

Over several devices each simulates its share of the robots; nothing passes between them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from agile_jax.simulation.mjx_physics import MjxModel, mjx_reset, mjx_step
from agile_jax.simulation.outcome import RUNNING
from agile_jax.simulation.rollout import ClosedLoop, Episode, resume_from
from agile_jax.simulation.sensed import Sensed
from agile_jax.simulation.slots import Rollout
from agile_jax.simulation.traces import Sample, sample_of

SEGMENT = 10  # plans between two looks at who has ended


class MjxState(NamedTuple):
    """One robot in MJX and its loop."""

    data: Any  # mjx.Data
    episode: Episode
    sensed: Sensed
    plans: jax.Array  # () int32


class MjxLoop(NamedTuple):
    """Compiled functions of many robots, a multiple of the number of devices; compiled anew for each number of them."""

    first: Callable[..., MjxState]  # (qpos (n, nq), time limits (n,)) -> states
    begin: Callable[..., MjxState]  # (mask (n,), qpos, time limits, states) -> states, new where masked
    # (policy parameters, states) -> states a segment later; was it running (n, SEGMENT), samples (n, SEGMENT, ...)
    advance: Callable[..., tuple[MjxState, tuple[jax.Array, Sample]]]
    devices: int


def mjx_loop(loop: ClosedLoop, model: MjxModel, devices: int = 1) -> MjxLoop:
    """Compile a closed loop with its physics; keep it, a second one would compile again.

    Args:
        loop: of one robot.
        model: from `mjx_init`.
        devices: how many of JAX's devices share the robots.
    """

    def one_act(carry: tuple[Any, Episode, Sensed], _: None) -> tuple[tuple[Any, Episode, Sensed], None]:
        data, episode, sensed = carry
        episode = loop.act(episode, sensed)
        data, sensed = mjx_step(model, data, episode.torque)
        return (data, episode, sensed), None

    def one_plan(parameters: Any, state: MjxState) -> tuple[MjxState, tuple[jax.Array, Sample]]:
        running = state.episode.outcome.status == RUNNING
        episode = loop.plan(parameters, (), state.episode, state.sensed)
        carry = (state.data, episode, state.sensed)
        (data, episode, sensed), _ = jax.lax.scan(one_act, carry, None, length=loop.acts_per_plan)
        return MjxState(data, episode, sensed, state.plans + running), (running, sample_of(episode, sensed))

    def init(qpos: jax.Array, limit: jax.Array) -> MjxState:
        touches_nothing = jnp.bool_(False)
        sensed = Sensed(
            qpos, jnp.zeros(model.model.nv, qpos.dtype), touches_nothing, touches_nothing, jnp.zeros(4, bool)
        )
        return MjxState(mjx_reset(model, qpos), loop.init(sensed, limit), sensed, jnp.int32(0))

    def begin(mask: jax.Array, qpos: jax.Array, limits: jax.Array, states: MjxState) -> MjxState:
        return resume_from(mask, jax.vmap(init)(qpos, limits), states)

    def advance(parameters: Any, state: MjxState) -> tuple[MjxState, tuple[jax.Array, Sample]]:
        return jax.lax.scan(lambda carry, _: one_plan(parameters, carry), state, None, length=SEGMENT)

    mesh, robots, everywhere = (
        Mesh(np.array(jax.devices()[:devices]), ("robots",)),
        PartitionSpec("robots"),
        PartitionSpec(),
    )

    def shared(function: Callable[..., Any], *specs: PartitionSpec) -> Callable[..., Any]:
        return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=robots, check_vma=False)

    return MjxLoop(
        jax.jit(shared(jax.vmap(init), robots, robots)),
        jax.jit(shared(begin, robots, robots, robots, robots), donate_argnums=3),
        jax.jit(shared(jax.vmap(advance, in_axes=(None, 0)), everywhere, robots), donate_argnums=1),
        devices,
    )


class MjxSlots:
    """Slots in MJX. One advance is a segment of plans on the device."""

    plans_per_advance = SEGMENT

    def __init__(self, loop: MjxLoop, count: int, parameters: Any) -> None:
        """Args: loop: from `mjx_loop`; count: of the slots, at least; parameters: of the policy."""
        self._loop, self._parameters = loop, parameters
        self._count = -(-count // loop.devices) * loop.devices
        self._states: MjxState | None = None

    @property
    def count(self) -> int:
        """How many episodes run at once."""
        return self._count

    def begin(self, slots: np.ndarray, qpos: np.ndarray, time_limits: np.ndarray) -> None:
        """Start new episodes."""
        all_qpos = np.repeat(np.asarray(qpos[:1], np.float32), self._count, 0)
        limits = np.zeros(self._count, np.float32)
        mask = np.zeros(self._count, bool)
        all_qpos[slots], limits[slots], mask[slots] = qpos, time_limits, True
        if self._states is None:
            self._states = self._loop.first(all_qpos, limits)
        else:
            self._states = self._loop.begin(mask, all_qpos, limits, self._states)

    def advance(self) -> np.ndarray:
        """Simulate a segment."""
        self._states, (self._running, self._samples) = self._loop.advance(self._parameters, self._states)
        return np.asarray(self._states.episode.outcome.status)

    def read(self, slots: np.ndarray) -> Rollout:
        """The results in some slots."""
        assert self._states is not None
        episode, plans = self._states.episode, np.asarray(self._states.plans)
        outcome = jax.tree.map(lambda values: np.asarray(values)[slots], episode.outcome)
        counts = jax.tree.map(lambda values: np.asarray(values)[slots], episode.controller.diagnostics.counts)
        return Rollout(outcome, counts, plans[slots])

    def snapshot(self) -> tuple[np.ndarray, Sample]:
        """The states of all slots after each plan of the last segment, still on the device."""
        return np.asarray(self._running), self._samples

    def samples(self, slot: int) -> list[Sample]:
        """The states of one slot after the plans of the last segment."""
        samples = jax.tree.map(lambda values: np.asarray(values[slot]), self._samples)
        running = np.asarray(self._running[slot])
        return [jax.tree.map(lambda values, k=k: values[k], samples) for k in np.flatnonzero(running)]
