"""Closed-loop evaluation: starts, expert times, episodes in chunks, summary.

Each chunk of episodes is committed as it finishes; a killed evaluation goes on with the next one. Chunks are padded to
one batch size, so that there is one compilation, and numbers do not depend on how many episodes are asked for.
"""

import pathlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from agile_jax.engine import Engine
from agile_jax.evaluation.backend import Backend, Inputs, make_backend
from agile_jax.evaluation.expert_time import expert_times
from agile_jax.evaluation.store import Columns, load_chunk, save_chunk, save_columns, save_traces
from agile_jax.evaluation.summary import summarize
from agile_jax.files import hash_json, write_json
from agile_jax.progress import silent
from agile_jax.scene import make_scene, sample_starts
from agile_jax.simulation import SUCCESS, Rollout

START_STREAM = 7_001  # sets the evaluation's random stream apart from those of dataset and training
NO_PATH_LIMIT = 20.0  # time limit where the expert found no path [s]


def time_limit(expert_time: np.ndarray) -> np.ndarray:
    """Time that an episode has: 2 T* + 3 s."""
    return np.where(np.isfinite(expert_time), 2 * expert_time + 3.0, NO_PATH_LIMIT)


def evaluation_starts(inputs: Inputs) -> np.ndarray:
    """Start poses that no training has seen, shape (episodes, 4) [m, rad]."""
    start = inputs.scene.start
    return sample_starts(
        make_scene(inputs.scene),
        np.array(start.mean),
        np.array(start.std),
        inputs.evaluation.episodes,
        inputs.expert.clearance_margin,
        (inputs.seed, START_STREAM, inputs.evaluation.seed),
    ).poses


def evaluate(
    inputs: Inputs,
    run_directory: pathlib.Path,
    engine: Callable[[], AbstractContextManager[Engine]],
    threads: int = 2,
    progress: Callable[[int, int, str], None] = silent,
) -> dict[str, Any]:
    """Run the episodes and write `evaluation/<backend>.json`, `.npz` and `-traces.npz`.

    Args:
        inputs: settings, for example an Experiment.
        run_directory: holds `training/`.
        engine: opens the work engine for the expert's times.
        threads: of the C physics.
        progress: called with (episodes ended, episodes, note).

    Returns:
        The summary, with the keys of the run directory's contract.
    """
    name = inputs.evaluation.backend
    folder = run_directory / "evaluation"
    chunks = folder / f"{name}-chunks"
    identity = evaluation_identity(inputs, run_directory / "training")
    starts = evaluation_starts(inputs)

    expert = load_chunk(chunks / "expert.npz", identity)
    if expert is None:
        progress(0, len(starts), "expert times")
        durations, branches = expert_times(inputs.scene, inputs.expert, starts, engine)
        expert = {"expert_time": durations, "branch": np.array(branches)}
        save_chunk(chunks / "expert.npz", identity, expert)
    limits = time_limit(expert["expert_time"])

    batch = min(inputs.evaluation.batch, len(starts))
    backend: Backend | None = None
    rows: list[Columns] = []
    for first in range(0, len(starts), batch):
        path = chunks / f"episodes-{first:06d}.npz"
        row = load_chunk(path, identity)
        if row is None:
            if backend is None:
                backend = make_backend(inputs, run_directory / "training", batch, threads, progress)
            selected = np.arange(first, first + batch) % len(starts)  # the last chunk is padded with the first starts
            count = min(batch, len(starts) - first)
            begun = time.perf_counter()
            rollout = backend.run(starts[selected], limits[selected], inputs.evaluation.traced if first == 0 else 0)
            if rollout.traces:
                save_traces(folder / f"{name}-traces.npz", rollout.traces)
            row = episode_rows(rollout, count)
            row["wall"] = np.full(count, (time.perf_counter() - begun) / count)
            row["device"] = np.full(count, backend.device)
            save_chunk(path, identity, row)
        rows.append(row)
        progress(min(first + batch, len(starts)), len(starts), "episodes")

    columns = {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}
    seconds, device = float(columns.pop("wall").sum()), str(columns.pop("device")[-1])
    columns |= {"start": starts, "time_limit": limits, **expert}
    summary = {"backend": name, "device": device, **summarize(columns, inputs.control, seconds)}
    save_columns(folder / f"{name}.npz", columns)
    write_json(folder / f"{name}.json", summary)
    return summary


def episode_rows(rollout: Rollout, count: int) -> Columns:
    """One entry for each of the first `count` episodes."""
    outcome = rollout.outcome
    steps = np.maximum(outcome.steps, 1)
    success = np.asarray(outcome.status) == SUCCESS
    columns = {
        "outcome": np.asarray(outcome.status, np.int8),
        "success": success,
        "end_time": outcome.time,
        "arrival_time": np.where(success, outcome.inside_since, np.nan),
        "min_clearance": outcome.min_clearance,
        "final_error": outcome.planar_error,
        "velocity_tracking_rmse": np.sqrt(outcome.velocity_error_sum / steps),
        "torque_saturation": outcome.saturated / (12 * steps),
        "steps": outcome.steps,
        **rollout.counts._asdict(),
        "plans": rollout.plans,
    }
    return {name: np.asarray(values)[:count] for name, values in columns.items()}


def evaluation_identity(inputs: Inputs, training_directory: pathlib.Path) -> str:
    """Hash of everything that the episodes depend on: settings and the policy's checkpoint."""
    settings = (
        inputs.scene,
        inputs.expert,
        inputs.policy,
        inputs.robot,
        inputs.control,
        inputs.evaluation,
    )
    checkpoints = sorted(training_directory.glob("checkpoints/**/integrity.json"))
    return hash_json(
        [inputs.seed, *(part.model_dump(mode="json") for part in settings), *(path.read_text() for path in checkpoints)]
    )
