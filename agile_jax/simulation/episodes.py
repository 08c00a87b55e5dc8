"""Many episodes at once, by either backend. Episodes do not know of each other: results do not depend on the batch."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.geometry import quaternion_to_rpy
from agile_jax.progress import silent
from agile_jax.scene import Scene, clearance
from agile_jax.simulation.outcome import RUNNING, Outcome
from agile_jax.simulation.rollout import ClosedLoop, Episode, Trace
from agile_jax.simulation.sensed import Sensed


class Rollout(NamedTuple):
    """What a batch of n episodes ended with."""

    outcome: Outcome  # leading axis n
    mpc_failures: np.ndarray  # (n,) solutions above the tolerance
    plans: np.ndarray  # (n,) solutions in all
    traces: list[Trace]  # of the first episodes


def run_mujoco(
    loop: ClosedLoop,
    physics: Any,
    parameters: Any,
    qpos: np.ndarray,
    time_limits: np.ndarray,
    scene: Scene,
    traced: int = 0,
    progress: Callable[[int, int, str], None] = silent,
) -> Rollout:
    """Closed loop in C MuJoCo: a thread pool steps the physics, one compiled call controls the whole batch.

    Args:
        loop: the closed loop of one robot.
        physics: `MujocoPhysics` for n episodes.
        parameters: of the policy.
        qpos: initial configurations, shape (n, 19).
        time_limits: shape (n,) [s].
        scene: for the clearance of the traces.
        traced: how many of the first episodes to record.
        progress: called with (episodes ended, n, note).
    """
    init = jax.jit(jax.vmap(loop.init))
    plan = jax.jit(jax.vmap(loop.plan, in_axes=(None, 0, 0)), donate_argnums=1)
    act = jax.jit(jax.vmap(loop.act), donate_argnums=0)
    sensed = physics.reset(qpos)
    episodes = init(as_float32(sensed), jnp.asarray(time_limits, jnp.float32))
    plans = np.zeros(len(qpos), int)
    records: list[tuple[np.ndarray, ...]] = []
    active = np.ones(len(qpos), bool)
    while active.any():
        plans += active
        episodes = plan(parameters, episodes, as_float32(sensed))
        for _ in range(loop.acts_per_plan):
            episodes = act(episodes, as_float32(sensed))
            sensed = physics.step(np.asarray(episodes.torque, np.float64), active)
        if traced:
            records.append(record(episodes, sensed, traced))
        active = np.asarray(episodes.outcome.status) == RUNNING
        progress(int((~active).sum()), len(qpos), f"{float(np.max(episodes.outcome.time)):.1f} s simulated")
    outcome = jax.tree.map(np.asarray, episodes.outcome)
    failures = np.asarray(episodes.controller.mpc_failures)
    plan_dt = loop.control_dt * loop.acts_per_plan
    return Rollout(outcome, failures, plans, cut_traces(records, outcome.time, traced, plan_dt, scene))


def run_mjx(
    loop: ClosedLoop,
    reset: Callable[[jax.Array], tuple[Any, Sensed]],
    step: Callable[[Any, jax.Array], tuple[Any, Sensed]],
    parameters: Any,
    qpos: np.ndarray,
    time_limits: np.ndarray,
) -> Rollout:
    """Closed loop in MJX: policy, controller, physics and outcome in one compiled loop, vmapped over the robots.

    Args:
        loop: the closed loop of one robot.
        reset, step: of one robot's physics.
        parameters: of the policy.
        qpos: initial configurations, shape (n, 19).
        time_limits: shape (n,) [s].
    """

    def one_act(carry: tuple[Any, Episode, Sensed], _: None) -> tuple[tuple[Any, Episode, Sensed], None]:
        data, episode, sensed = carry
        episode = loop.act(episode, sensed)
        data, sensed = step(data, episode.torque)
        return (data, episode, sensed), None

    def one_plan(data: Any, episode: Episode, sensed: Sensed, plans: jax.Array, parameters: Any) -> Any:
        plans = plans + (episode.outcome.status == RUNNING)
        episode = loop.plan(parameters, episode, sensed)
        (data, episode, sensed), _ = jax.lax.scan(one_act, (data, episode, sensed), None, length=loop.acts_per_plan)
        return data, episode, sensed, plans

    def run(parameters: Any, qpos: jax.Array, limits: jax.Array) -> tuple[Episode, jax.Array]:
        data, sensed = jax.vmap(reset)(qpos)
        episodes = jax.vmap(loop.init)(sensed, limits)
        carry = (data, episodes, sensed, jnp.zeros(len(qpos), jnp.int32))
        advance = jax.vmap(one_plan, in_axes=(0, 0, 0, 0, None))
        carry = jax.lax.while_loop(
            lambda c: (c[1].outcome.status == RUNNING).any(), lambda c: advance(*c, parameters), carry
        )
        return carry[1], carry[3]

    limits = jnp.asarray(time_limits, jnp.float32)
    episodes, plans = jax.jit(run)(parameters, jnp.asarray(qpos, jnp.float32), limits)
    outcome = jax.tree.map(np.asarray, episodes.outcome)
    return Rollout(outcome, np.asarray(episodes.controller.mpc_failures), np.asarray(plans), [])


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
