"""Closed-loop evaluation: starts, expert times, episodes in chunks, summary.

Each chunk of episodes is committed as it finishes; a killed evaluation goes on with those that are missing.
"""

import pathlib
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import jax
import numpy as np

from agile_jax.dataset import expert_times, time_limit
from agile_jax.engine import Engine, TaskFailure, TasksFailedError
from agile_jax.evaluation.backend import Inputs, command_parameters, make_backend
from agile_jax.evaluation.breakdown import distributions, outcomes_by_region
from agile_jax.evaluation.episodes import PART_TIME_LIMIT_S, Part, simulate, simulate_part
from agile_jax.evaluation.store import Columns, load_chunk, save_chunk, save_columns, save_traces
from agile_jax.evaluation.summary import summarize
from agile_jax.files import hash_json, write_json
from agile_jax.progress import Progress, silent
from agile_jax.robot import load_robot
from agile_jax.scene import clearance, make_scene, sample_starts
from agile_jax.simulation import Recorder, Trace

START_STREAM = 7_001  # sets the evaluation's random stream apart from those of dataset and training
CHUNK = 64  # episodes a file
LONGEST_PART = 8  # chunks that a worker simulates at a time
PARTS_A_WORKER = 4  # at least, where there are enough chunks: workers end at about the same time


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
    progress: Progress = silent,
) -> dict[str, Any]:
    """Run the episodes and write `evaluation/<backend>.json`, `.npz` and `-traces.npz`.

    The last second of an episode that ended unstable goes into `<backend>-unstable/`, for `agile rollout --replay`.

    Args:
        inputs: settings, for example an Experiment.
        run_directory: holds `training/`.
        engine: opens the work engine for the expert's times, and for the episodes with `where` = "workers".
        threads: of the C physics.
        progress: is told of the episodes that have ended.

    Returns:
        The summary, with the keys of the run directory's contract.

    Raises:
        TasksFailedError: a worker failed for good; what was simulated is kept.
    """
    name = inputs.evaluation.backend
    folder = run_directory / "evaluation"
    chunks = folder / f"{name}-chunks"
    identity = evaluation_identity(inputs, run_directory / "training")
    starts = evaluation_starts(inputs)

    expert = load_chunk(chunks / "expert.npz", identity)
    if expert is None:
        progress("expert times", 0, len(starts))
        found = expert_times(inputs.scene, inputs.expert, starts, engine)
        expert = {
            "expert_time": found.duration,
            "expert_arrival_time": found.arrival,
            "branch": np.array(found.branch),
        }
        save_chunk(chunks / "expert.npz", identity, expert)
    limits = time_limit(expert["expert_time"])

    stored = _Chunks(inputs, folder, identity, len(starts), progress)
    if stored.missing():
        parameters = command_parameters(inputs, run_directory / "training")
        if inputs.evaluation.where == "workers":
            _simulate_on_workers(inputs, stored, parameters, starts, limits, identity, engine)
        else:
            _simulate_here(inputs, stored, parameters, starts, limits, threads)
    columns = stored.columns()
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


class _Chunks:
    """The rows of all episodes, in files of `CHUNK` that are written as they become complete."""

    def __init__(self, inputs: Inputs, folder: pathlib.Path, identity: str, episodes: int, progress: Progress) -> None:
        self._name, self._folder, self._identity = inputs.evaluation.backend, folder, identity
        self._episodes, self._progress, self._begun = episodes, progress, time.perf_counter()
        firsts = range(0, episodes, CHUNK)
        self._paths = [folder / f"{self._name}-chunks" / f"episodes-{first:06d}.npz" for first in firsts]
        loaded = enumerate(load_chunk(path, identity) for path in self._paths)
        self._rows = {chunk: row for chunk, row in loaded if row is not None}
        self._there = sum(len(self.members(chunk)) for chunk in self._rows)

    def missing(self) -> list[int]:
        """Numbers of the chunks that are not there yet."""
        return [chunk for chunk in range(len(self._paths)) if chunk not in self._rows]

    def members(self, chunk: int) -> np.ndarray:
        """The episodes of a chunk."""
        return np.arange(chunk * CHUNK, min((chunk + 1) * CHUNK, self._episodes))

    def commit(self, chunk: int, columns: Columns, device: str, query_seconds: float, traces: list[Trace]) -> None:
        """Write a chunk, and the traces if it has some."""
        count, now = len(self.members(chunk)), time.perf_counter()
        about = {"wall": (now - self._begun) / count, "device": device, "query_seconds": query_seconds}
        self._begun = now
        columns = columns | {key: np.full(count, value) for key, value in about.items()}
        if traces:
            save_traces(self._folder / f"{self._name}-traces.npz", traces)
        save_chunk(self._paths[chunk], self._identity, columns)
        self._rows[chunk] = columns

    def keep_unstable(self, episode: int, trace: Trace) -> None:
        """Write the last second of an episode, for `agile rollout --replay`."""
        save_traces(self._folder / f"{self._name}-unstable" / f"episode-{episode:06d}.npz", [trace])

    def report(self, done: int) -> None:
        """Say how many of the episodes that were missing are done."""
        self._progress("episodes", self._there + done, self._episodes)

    def columns(self) -> Columns:
        """All rows."""
        rows = [self._rows[chunk] for chunk in range(len(self._paths))]
        return {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}


def _simulate_here(
    inputs: Inputs, chunks: _Chunks, parameters: Any, starts: np.ndarray, limits: np.ndarray, threads: int
) -> None:
    """All missing episodes through one batch of slots."""
    numbers = np.concatenate([chunks.members(chunk) for chunk in chunks.missing()])
    traced = inputs.evaluation.traced if numbers[0] == 0 else 0
    backend = make_backend(inputs, parameters, min(inputs.evaluation.batch, len(numbers)), threads)
    incomplete: dict[int, dict[int, Columns]] = {}  # by chunk and episode
    done = 0
    recorder = Recorder(backend.slots, traced)
    for ended in simulate(backend, inputs, starts[numbers], limits[numbers], recorder):
        for position, row, trace in ended:
            episode = int(numbers[position])
            chunk = episode // CHUNK
            if trace is not None:
                chunks.keep_unstable(episode, trace)
            rows = incomplete.setdefault(chunk, {})
            rows[episode] = row
            if len(rows) == len(chunks.members(chunk)):
                columns = {key: np.concatenate([rows[i][key] for i in sorted(rows)]) for key in row}
                traces = recorder.traces(make_scene(inputs.scene), backend.plan_dt) if chunk == 0 else []
                chunks.commit(chunk, columns, backend.device, backend.query_seconds(), traces)
                del incomplete[chunk]
        done += len(ended)
        chunks.report(done)


def _simulate_on_workers(
    inputs: Inputs,
    chunks: _Chunks,
    parameters: Any,
    starts: np.ndarray,
    limits: np.ndarray,
    identity: str,
    engine: Callable[[], AbstractContextManager[Engine]],
) -> None:
    """The missing chunks in the engine's workers, some at a time."""
    arrays = jax.tree.map(np.asarray, parameters)
    failures = []
    done = 0
    with engine() as opened:
        groups = _groups(chunks.missing(), opened.workers)
        numbers = [np.concatenate([chunks.members(chunk) for chunk in group]) for group in groups]
        parts = [
            Part(identity, inputs, arrays, starts[own], limits[own], inputs.evaluation.traced if own[0] == 0 else 0)
            for own in numbers
        ]
        for position, result in opened.map(simulate_part, parts, time_limit_s=PART_TIME_LIMIT_S):
            own = numbers[position]
            if isinstance(result, TaskFailure):
                failures.append(f"episodes from {own[0]}: {result.cause}")
                continue
            for place, trace in result.unstable.items():
                chunks.keep_unstable(int(own[place]), trace)
            for chunk in groups[position]:
                rows = {key: values[np.isin(own, chunks.members(chunk))] for key, values in result.columns.items()}
                traces = result.traces if chunk == 0 else []
                chunks.commit(chunk, rows, result.device, result.query_seconds, traces)
            done += len(own)
            chunks.report(done)
    if failures:
        raise TasksFailedError(
            f"{len(failures)} parts of the evaluation failed ({'; '.join(sorted(failures))}); "
            "the others are kept, and the same command tries again"
        )


def _groups(chunks: list[int], workers: int) -> list[list[int]]:
    """Chunks that a worker simulates as one stream, so that fewer slots wait for the last episode: several for each."""
    size = min(LONGEST_PART, max(1, len(chunks) // (PARTS_A_WORKER * workers)))
    return [chunks[first : first + size] for first in range(0, len(chunks), size)]


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
