"""Many episodes at once, by either backend. Episodes do not know of each other: results do not depend on the batch."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.control import Counts
from agile_jax.geometry import quaternion_to_rpy
from agile_jax.progress import silent
from agile_jax.scene import Scene, clearance
from agile_jax.simulation.mjx_physics import MjxModel, mjx_reset, mjx_step
from agile_jax.simulation.mujoco_physics import MujocoPhysics
from agile_jax.simulation.outcome import RUNNING, Outcome
from agile_jax.simulation.rollout import ClosedLoop, Episode, Trace
from agile_jax.simulation.sensed import Sensed


class Rollout(NamedTuple):
    """What a batch of n episodes ended with."""

    outcome: Outcome  # leading axis n
    counts: Counts  # of the controller, leading axis n
    plans: np.ndarray  # (n,) solutions in all
    traces: list[Trace]  # of the first episodes


class MjxState(NamedTuple):
    """One robot in MJX and its loop."""

    data: Any  # mjx.Data
    episode: Episode
    sensed: Sensed
    plans: jax.Array  # () int32


class BatchLoop(NamedTuple):
    """The functions of a closed loop, vmapped and compiled once."""

    init: Callable[..., Episode]
    plan: Callable[..., Episode]
    act: Callable[..., Episode]
    control_dt: float  # [s]
    acts_per_plan: int


def batch_loop(loop: ClosedLoop) -> BatchLoop:
    """Compile a closed loop for batches; keep it, a second one would compile again."""
    return BatchLoop(
        jax.jit(jax.vmap(loop.init)),
        jax.jit(jax.vmap(loop.plan, in_axes=(None, 0, 0)), donate_argnums=1),
        jax.jit(jax.vmap(loop.act), donate_argnums=0),
        loop.control_dt,
        loop.acts_per_plan,
    )


def run_mujoco(
    loop: BatchLoop,
    physics: MujocoPhysics,
    parameters: Any,
    qpos: np.ndarray,
    time_limits: np.ndarray,
    scene: Scene,
    traced: int = 0,
    progress: Callable[[int, int, str], None] = silent,
) -> Rollout:
    """Closed loop in C MuJoCo: a thread pool steps the physics, one compiled call controls the whole batch.

    Args:
        loop: from `batch_loop`.
        physics: for n episodes.
        parameters: of the policy.
        qpos: initial configurations, shape (n, 19).
        time_limits: shape (n,) [s].
        scene: for the clearance of the traces.
        traced: how many of the first episodes to record.
        progress: called with (episodes ended, n, note).
    """
    sensed = physics.reset(qpos)
    episodes = loop.init(as_float32(sensed), jnp.asarray(time_limits, jnp.float32))
    plans = np.zeros(len(qpos), int)
    records: list[tuple[np.ndarray, ...]] = []
    active = np.ones(len(qpos), bool)
    while active.any():
        plans += active
        episodes = loop.plan(parameters, episodes, as_float32(sensed))
        for _ in range(loop.acts_per_plan):
            episodes = loop.act(episodes, as_float32(sensed))
            sensed = physics.step(np.asarray(episodes.torque, np.float64), active)
        if traced:
            records.append(record(episodes, sensed, traced))
        active = np.asarray(episodes.outcome.status) == RUNNING
        progress(int((~active).sum()), len(qpos), f"{float(np.max(episodes.outcome.time)):.1f} s simulated")
    outcome = jax.tree.map(np.asarray, episodes.outcome)
    counts = jax.tree.map(np.asarray, episodes.controller.diagnostics.counts)
    plan_dt = loop.control_dt * loop.acts_per_plan
    return Rollout(outcome, counts, plans, cut_traces(records, outcome.time, traced, plan_dt, scene))


def mjx_runner(loop: ClosedLoop, model: MjxModel) -> Callable[[Any, np.ndarray, np.ndarray], Rollout]:
    """Closed loop in MJX: policy, controller, physics and outcome in one compiled loop, vmapped over the robots.

    Args:
        loop: the closed loop of one robot.
        model: of one robot's physics.

    Returns:
        (policy parameters, qpos (n, 19), time limits (n,) [s]) -> Rollout without traces. Compiles once for each n.
    """

    def one_act(carry: tuple[Any, Episode, Sensed], _: None) -> tuple[tuple[Any, Episode, Sensed], None]:
        data, episode, sensed = carry
        episode = loop.act(episode, sensed)
        data, sensed = mjx_step(model, data, episode.torque)
        return (data, episode, sensed), None

    def one_plan(parameters: Any, state: MjxState) -> MjxState:
        plans = state.plans + (state.episode.outcome.status == RUNNING)
        episode = loop.plan(parameters, state.episode, state.sensed)
        carry = (state.data, episode, state.sensed)
        (data, episode, sensed), _ = jax.lax.scan(one_act, carry, None, length=loop.acts_per_plan)
        return MjxState(data, episode, sensed, plans)

    def begin(qpos: jax.Array, limit: jax.Array) -> MjxState:
        touches_nothing = jnp.bool_(False)
        sensed = Sensed(qpos, jnp.zeros(model.model.nv, qpos.dtype), touches_nothing, touches_nothing)
        return MjxState(mjx_reset(model, qpos), loop.init(sensed, limit), sensed, jnp.int32(0))

    @jax.jit
    def run(parameters: Any, qpos: jax.Array, limits: jax.Array) -> tuple[Outcome, Counts, jax.Array]:
        end = jax.lax.while_loop(
            lambda state: (state.episode.outcome.status == RUNNING).any(),
            lambda state: jax.vmap(one_plan, in_axes=(None, 0))(parameters, state),
            jax.vmap(begin)(qpos, limits),
        )
        return end.episode.outcome, end.episode.controller.diagnostics.counts, end.plans

    def run_batch(parameters: Any, qpos: np.ndarray, limits: np.ndarray) -> Rollout:
        results = run(parameters, jnp.asarray(qpos, jnp.float32), jnp.asarray(limits, jnp.float32))
        outcome, counts, plans = jax.tree.map(np.asarray, results)
        return Rollout(outcome, counts, plans, [])

    return run_batch


def as_float32(sensed: Sensed) -> Sensed:
    """The controller's precision."""
    return Sensed(
        jnp.asarray(sensed.qpos, jnp.float32),
        jnp.asarray(sensed.qvel, jnp.float32),
        jnp.asarray(sensed.obstacle_contact),
        jnp.asarray(sensed.floor_contact),
    )


def record(episodes: Episode, sensed: Sensed, traced: int) -> tuple[np.ndarray, ...]:
    """One sample of the first `traced` episodes: qpos, qvel, torque, reference."""
    reference = np.concatenate([episodes.reference.pose[:traced], episodes.reference.velocity[:traced]], -1)
    return (
        np.array(sensed.qpos[:traced]),
        np.array(sensed.qvel[:traced]),
        np.asarray(episodes.torque[:traced]),
        reference,
    )


def cut_traces(
    records: list[tuple[np.ndarray, ...]], end_times: np.ndarray, traced: int, plan_dt: float, scene: Scene
) -> list[Trace]:
    """Stack the samples by episode, each up to its end, and add the torso's clearance."""
    if not traced:
        return []
    qpos, qvel, torque, reference = (np.stack(samples, 1) for samples in zip(*records, strict=True))  # (traced, K, ...)
    time = plan_dt * np.arange(1, qpos.shape[1] + 1)
    traces = []
    for episode in range(len(qpos)):
        last = max(1, int(np.ceil(end_times[episode] / plan_dt - 1e-6)))
        poses = np.concatenate([qpos[episode, :, :3], quaternion_to_rpy(qpos[episode, :, 3:7])[:, 2:]], -1)
        traces.append(
            Trace(
                time[:last],
                qpos[episode, :last],
                qvel[episode, :last],
                torque[episode, :last],
                reference[episode, :last],
                clearance(scene, poses[:last]),
            )
        )
    return traces
