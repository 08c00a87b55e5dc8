"""Episodes as rows of columns, simulated in this process, or by parts in the workers of an engine."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from agile_jax.evaluation.backend import Backend, Inputs, make_backend
from agile_jax.evaluation.store import Columns
from agile_jax.scene import make_scene
from agile_jax.simulation import SUCCESS, UNSTABLE, LastStates, Recorder, Rollout, Trace, stream

PART_TIME_LIMIT_S = 3600.0  # after which a part counts as hung: a hundred times what it takes on one core


class Part(NamedTuple):
    """Episodes for a worker."""

    identity: str  # of the evaluation
    inputs: Inputs
    parameters: Any  # of what the controller follows, NumPy
    starts: np.ndarray  # (n, 4)
    limits: np.ndarray  # (n,) [s]
    traced: int  # the first of them are recorded


class PartResult(NamedTuple):
    """What became of them."""

    columns: Columns
    traces: list[Trace]
    unstable: dict[int, Trace]  # the last second, by position
    device: str
    query_seconds: float


def simulate(
    backend: Backend, inputs: Inputs, starts: np.ndarray, limits: np.ndarray, recorder: Recorder
) -> Iterator[list[tuple[int, Columns, Trace | None]]]:
    """Run episodes and yield those that have just ended.

    Args:
        backend: where they run.
        inputs: for the scene.
        starts: poses, shape (n, 4).
        limits: shape (n,) [s].
        recorder: of the backend's slots.

    Yields:
        Of each ended episode its index, its row of columns and, if it ended unstable, its last second.
    """
    scene = make_scene(inputs.scene)
    last = LastStates(backend.slots)

    def watch(holds: np.ndarray) -> None:
        recorder(holds)
        last(holds)

    for indices, rollout in stream(backend.slots, backend.qpos(starts), limits, watch):
        ended: list[tuple[int, Columns, Trace | None]] = []
        for episode, row in zip(indices.tolist(), _rows(rollout), strict=True):
            trace = None
            if row["outcome"][0] == UNSTABLE:
                trace = last.trace(episode, float(row["end_time"][0]), scene, backend.plan_dt)
            ended.append((episode, row, trace))
        yield ended


_BACKENDS: dict[tuple[str, int], Backend] = {}  # of this worker, the last one: compiling takes longer than a part


def simulate_part(part: Part) -> PartResult:
    """Simulate a part on one core. Runs in a worker."""
    inputs, batch = part.inputs, min(part.inputs.evaluation.batch, len(part.starts))
    key = (part.identity, batch)
    if key not in _BACKENDS:
        _BACKENDS.clear()
        _BACKENDS[key] = make_backend(inputs, part.parameters, batch, 1)
    backend = _BACKENDS[key]
    rows: dict[int, Columns] = {}
    unstable: dict[int, Trace] = {}
    recorder = Recorder(backend.slots, part.traced)
    for ended in simulate(backend, inputs, part.starts, part.limits, recorder):
        for episode, row, trace in ended:
            rows[episode] = row
            if trace is not None:
                unstable[episode] = trace
    columns = {key: np.concatenate([rows[i][key] for i in range(len(rows))]) for key in rows[0]}
    traces = recorder.traces(make_scene(inputs.scene), backend.plan_dt)
    return PartResult(columns, traces, unstable, backend.device, backend.query_seconds())


def _rows(rollout: Rollout) -> list[Columns]:
    """One row of columns of length 1 for each episode."""
    columns = episode_columns(rollout)
    return [{key: values[i : i + 1] for key, values in columns.items()} for i in range(len(rollout.plans))]


def episode_columns(rollout: Rollout) -> Columns:
    """One entry for each episode."""
    outcome = rollout.outcome
    steps = np.maximum(outcome.steps, 1)
    success = np.asarray(outcome.status) == SUCCESS
    columns = {
        "outcome": np.asarray(outcome.status, np.int8),
        "success": success,
        "end_time": outcome.time,
        "arrival_time": np.where(success, outcome.inside_since, np.nan),
        "min_clearance": outcome.min_clearance,
        "min_envelope_clearance": outcome.min_envelope_clearance,
        "final_error": outcome.planar_error,
        "velocity_tracking_rmse": np.sqrt(outcome.velocity_error_sum / steps),
        "torque_saturation": outcome.saturated / (12 * steps),
        "work": outcome.work,
        "distance": outcome.distance,
        "steps": outcome.steps,
        **rollout.counts._asdict(),
        "plans": rollout.plans,
    }
    return {name: np.asarray(values) for name, values in columns.items()}
