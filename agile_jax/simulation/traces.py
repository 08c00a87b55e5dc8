"""Recording chosen episodes at the rate of the MPC, for figures and videos."""

from collections import defaultdict, deque
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from agile_jax.arrays import AnyArray
from agile_jax.robot import trunk_pose
from agile_jax.scene import Scene, clearance
from agile_jax.simulation.closed_loop import Episode
from agile_jax.simulation.sensed import Sensed


class Trace(NamedTuple):
    """One recorded episode at the rate of the MPC, K samples."""

    time: Float[np.ndarray, " K"]  # [s]
    qpos: Float[np.ndarray, "K 19"]  # [m, quaternion wxyz, rad]
    qvel: Float[np.ndarray, "K 18"]  # [m/s in the world, rad/s in the base, rad/s]
    torque: Float[np.ndarray, "K 12"]  # [Nm]
    reference: Float[np.ndarray, "K 8"]  # pose and velocity of the reference [m, rad], [m/s, rad/s]
    mpc_status: Int[np.ndarray, " K"]  # of the MPC's solution, `control.mpc.solver`
    mpc_residual: Float[np.ndarray, " K"]  # its largest [N]
    saturated: Bool[np.ndarray, "K 12"]  # torques cut to their limit
    clearance: Float[np.ndarray, " K"]  # of the torso's envelope [m]


class Sample(NamedTuple):
    """One robot before the next plan; fields as in `Trace`. In a batch, its axes lead."""

    qpos: Float[AnyArray, "19"]
    qvel: Float[AnyArray, "18"]
    torque: Float[AnyArray, "12"]
    reference: Float[AnyArray, "8"]
    mpc_status: Int[AnyArray, ""]
    mpc_residual: Float[AnyArray, ""]
    saturated: Bool[AnyArray, "12"]


def sample_of(episode: Episode, sensed: Sensed) -> Sample:
    """What is recorded of a robot, or of a batch."""
    reference, diagnostics = episode.reference, episode.diagnostics
    return Sample(
        sensed.qpos,
        sensed.qvel,
        episode.torque,
        jnp.concatenate([reference.pose, reference.velocity], -1),
        diagnostics.status,
        jnp.maximum(diagnostics.primal_residual, diagnostics.dual_residual),
        diagnostics.saturated,
    )


@runtime_checkable
class Snapshots(Protocol):
    """Slots that can be looked into all at once."""

    @property
    def plans_per_advance(self) -> int:
        """Plans between two looks."""

    def snapshot(self) -> tuple[np.ndarray, Sample]:
        """After the last advance of count slots: was it running (count, k), samples (count, k, ...)."""


class Recorder:
    """Collects the samples of the first episodes of a stream; pass it as `watch`."""

    def __init__(self, slots: Snapshots, episodes: int) -> None:
        self._slots, self._episodes = slots, episodes
        self._samples: dict[int, list[Sample]] = defaultdict(list)

    def __call__(self, holds: np.ndarray) -> None:
        """Take the samples of the recorded episodes; `holds` is the episode of each slot."""
        recorded = np.flatnonzero((holds >= 0) & (holds < self._episodes))
        if len(recorded):
            running, batch = self._slots.snapshot()
            for slot in recorded:
                self._samples[int(holds[slot])] += _samples_in(int(slot), running, batch)

    def traces(self, scene: Scene, plan_dt: float) -> list[Trace]:
        """The traces in the order of the episodes, with the clearance of the torso's envelope in `scene`."""
        return [_trace(self._samples[episode], scene, plan_dt) for episode in sorted(self._samples)]


class LastStates:
    """Keeps the last second or so of all episodes, to look at those that fail; pass it as `watch`."""

    def __init__(self, slots: Snapshots, plans: int = 50) -> None:
        self._slots = slots
        looks = -(-plans // slots.plans_per_advance)
        self._history: deque[tuple[np.ndarray, np.ndarray, Sample]] = deque(maxlen=looks)

    def __call__(self, holds: np.ndarray) -> None:
        """Take a snapshot; `holds` is the episode of each slot."""
        self._history.append((holds.copy(), *self._slots.snapshot()))

    def trace(self, episode: int, end: float, scene: Scene, plan_dt: float) -> Trace:
        """The last samples of an episode that ended at time `end` [s]."""
        samples = []
        for holds, running, batch in self._history:
            for slot in np.flatnonzero(holds == episode):
                samples += _samples_in(int(slot), running, batch)
        trace = _trace(samples, scene, plan_dt)
        return trace._replace(time=trace.time + end - trace.time[-1])


def _samples_in(slot: int, running: np.ndarray, batch: Sample) -> list[Sample]:
    """The samples of one slot, one for each plan for which it was running."""
    own = [np.array(values[slot]) for values in batch]
    return [Sample(*(values[k] for values in own)) for k in np.flatnonzero(running[slot])]


def _trace(samples: list[Sample], scene: Scene, plan_dt: float) -> Trace:
    stacked = Sample(*(np.stack(values) for values in zip(*samples, strict=True)))
    time = plan_dt * np.arange(1, len(samples) + 1)
    return Trace(time, *stacked, clearance=np.asarray(clearance(scene, trunk_pose(stacked.qpos))))
