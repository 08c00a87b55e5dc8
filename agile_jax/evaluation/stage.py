"""Closed-loop evaluation: starts, expert times, episodes in chunks, summary.

Each chunk of episodes is committed as it finishes; a killed evaluation goes on with those that are missing.
"""

import pathlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from agile_jax.dataset import expert_times
from agile_jax.engine import Engine
from agile_jax.evaluation.backend import Inputs, make_backend
from agile_jax.evaluation.breakdown import distributions, outcomes_by_region
from agile_jax.evaluation.store import Columns, load_chunk, save_chunk, save_columns, save_traces
from agile_jax.evaluation.summary import summarize
from agile_jax.files import hash_json, write_json
from agile_jax.progress import silent
from agile_jax.robot import load_robot
from agile_jax.scene import clearance, make_scene, sample_starts
from agile_jax.simulation import SUCCESS, UNSTABLE, LastStates, Recorder, Rollout, stream

START_STREAM = 7_001  # sets the evaluation's random stream apart from those of dataset and training
CHUNK = 64  # episodes a file
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

    The last second of an episode that ended unstable goes into `<backend>-unstable/`, for `agile rollout --replay`.

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

    rows = _episodes(inputs, run_directory, identity, starts, limits, threads, progress)
    columns = {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}
    seconds, device = float(columns.pop("wall").sum()), str(columns.pop("device")[-1])
    query_seconds = float(np.median(columns.pop("query_seconds")))
    columns |= {"start": starts, "time_limit": limits, **expert}
    scene, robot = make_scene(inputs.scene), load_robot(inputs.robot)
    summary = {
        "backend": name,
        "device": device,
        "planner": inputs.evaluation.planner,
        "planning_ms_per_query_median": 1e3 * query_seconds,
        **summarize(columns, inputs.control, seconds),
        **distributions(columns, float(robot.link_masses.sum())),
        "outcomes_by_region": outcomes_by_region(columns, np.asarray(clearance(scene, starts))),
    }
    save_columns(folder / f"{name}.npz", columns)
    write_json(folder / f"{name}.json", summary)
    return summary


def _episodes(
    inputs: Inputs,
    run_directory: pathlib.Path,
    identity: str,
    starts: np.ndarray,
    limits: np.ndarray,
    threads: int,
    progress: Callable[[int, int, str], None],
) -> list[Columns]:
    """The rows of all episodes, chunk by chunk: those committed before, and those that are missing."""
    name = inputs.evaluation.backend
    folder = run_directory / "evaluation"
    paths = [folder / f"{name}-chunks" / f"episodes-{first:06d}.npz" for first in range(0, len(starts), CHUNK)]
    rows = {chunk: row for chunk, path in enumerate(paths) if (row := load_chunk(path, identity)) is not None}
    missing = [i for i in range(len(starts)) if i // CHUNK not in rows]
    if not missing:
        return [rows[chunk] for chunk in range(len(paths))]

    backend = make_backend(inputs, run_directory / "training", min(inputs.evaluation.batch, len(missing)), threads)
    recorder = Recorder(backend.slots, inputs.evaluation.traced if 0 not in rows else 0)
    last = LastStates(backend.slots)

    def watch(holds: np.ndarray) -> None:
        recorder(holds)
        last(holds)

    open_chunks: dict[int, dict[int, Columns]] = {}  # by chunk and episode
    done, begun = len(starts) - len(missing), time.perf_counter()
    for indices, rollout in stream(backend.slots, backend.qpos(starts[missing]), limits[missing], watch):
        for episode, row in zip(indices, _rows(rollout), strict=True):
            i = missing[episode]
            if row["outcome"][0] == UNSTABLE:
                trace = last.trace(episode, float(row["end_time"][0]), make_scene(inputs.scene), backend.plan_dt)
                save_traces(folder / f"{name}-unstable" / f"episode-{i:06d}.npz", [trace])
            chunk = i // CHUNK
            members = open_chunks.setdefault(chunk, {})
            members[i] = row
            if len(members) < min(CHUNK, len(starts) - chunk * CHUNK):
                continue
            count, now = len(members), time.perf_counter()
            columns = {key: np.concatenate([members[i][key] for i in sorted(members)]) for key in row}
            columns |= {"wall": np.full(count, (now - begun) / count), "device": np.full(count, backend.device)}
            columns |= {"query_seconds": np.full(count, backend.query_seconds())}
            begun = now
            if chunk == 0 and inputs.evaluation.traced:
                save_traces(folder / f"{name}-traces.npz", recorder.traces(make_scene(inputs.scene), backend.plan_dt))
            save_chunk(paths[chunk], identity, columns)
            rows[chunk] = columns
            del open_chunks[chunk]
        done += len(indices)
        progress(done, len(starts), "episodes")
    return [rows[chunk] for chunk in range(len(paths))]


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
