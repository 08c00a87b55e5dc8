"""Episodes as rows of columns, simulated in this process, or by parts in the workers of an engine."""

import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, PyTree

from agile_jax.engine import TaskFailure, TasksFailedError
from agile_jax.evaluation.backend import Backend, make_backend, on_one_blas_thread
from agile_jax.evaluation.kept import Columns, KeptEvaluation, joined
from agile_jax.experiment import Experiment
from agile_jax.progress import Progress
from agile_jax.scene import make_scene
from agile_jax.simulation import SUCCESS, UNSTABLE, LastStates, Recorder, Rollout, Trace, stream
from agile_jax.store.parts import OpenEngine

FILE = 64  # episodes a file
# At once, at least: programs compiled for one or two robots round otherwise than those for more.
FEWEST_SLOTS = 4
LONGEST_PART = 512  # episodes that a worker simulates as one stream
PARTS_A_WORKER = 4  # at least, where there are enough episodes: workers end at about the same time
PART_TIME_LIMIT_S = 3600.0  # after which a part counts as hung: a hundred times what it takes on one core


class Work(NamedTuple):
    """Episodes to simulate."""

    key: str  # of the evaluation
    experiment: Experiment
    parameters: PyTree  # of what the controller follows
    episodes: Int[np.ndarray, " n"]  # their numbers, increasing
    starts: Float[np.ndarray, "n 4"]  # [m, rad]
    limits: Float[np.ndarray, " n"]  # of time [s]
    push_after: Float[np.ndarray, " n"]  # [s]
    traced: int  # the first of them are recorded

    @property
    def slots(self) -> int:
        """How many episodes run at once."""
        return max(min(self.experiment.evaluation.batch, len(self.episodes)), FEWEST_SLOTS)

    def part(self, rows: slice) -> "Work":
        """Some of the episodes; `rows` has no negative numbers."""
        return self._replace(
            episodes=self.episodes[rows],
            starts=self.starts[rows],
            limits=self.limits[rows],
            push_after=self.push_after[rows],
            traced=max(0, self.traced - rows.start),
        )


class Ended(NamedTuple):
    """An episode that has ended."""

    row: Columns  # of length 1
    last_second: Trace | None  # when it ended unstable


class PartResult(NamedTuple):
    """What became of a part's episodes."""

    rows: Columns
    traces: dict[int, Trace]  # by the episode's number
    unstable: dict[int, Trace]


def simulate(backend: Backend, work: Work, recorder: Recorder) -> Iterator[Ended]:
    """Run episodes and yield each that has ended."""
    scene = make_scene(work.experiment.scene)
    last = LastStates(backend.slots)

    def watch(holds: np.ndarray) -> None:
        recorder(holds)
        last(holds)

    for indices, rollout in stream(
        backend.slots,
        backend.qpos(work.starts),
        work.limits,
        watch,
        backend.plants(work.episodes, work.push_after),
        backend.keys(work.episodes),
    ):
        columns = {"episode": work.episodes[indices], **episode_columns(rollout)}
        for i, index in enumerate(indices.tolist()):
            row = {name: values[i : i + 1] for name, values in columns.items()}
            unstable = row["outcome"][0] == UNSTABLE
            trace = last.trace(index, float(row["end_time"][0]), scene, backend.plan_dt) if unstable else None
            yield Ended(row, trace)


@on_one_blas_thread
def simulate_here(work: Work, kept: KeptEvaluation, threads: int, progress: Progress) -> None:
    """Simulate in this process and keep what has ended, file by file."""
    count, there = len(work.episodes), work.experiment.evaluation.episodes - len(work.episodes)
    backend = make_backend(work.experiment, work.parameters, work.slots, threads)
    recorder = Recorder(backend.slots, work.traced)
    recorded = set(work.episodes[: work.traced].tolist())
    waiting: list[Columns] = []
    done, begun = 0, time.perf_counter()
    for ended in simulate(backend, work, recorder):
        episode, done = int(ended.row["episode"][0]), done + 1
        recorded.discard(episode)
        waiting.append(ended.row)
        if ended.last_second is not None:
            kept.add_unstable(episode, ended.last_second)
        if work.traced and not recorded:
            for episode, trace in _traces(work, backend, recorder).items():
                kept.add_trace(episode, trace)
            work = work._replace(traced=0)
        if len(waiting) >= FILE or done == count:
            now = time.perf_counter()
            kept.add(_with_measures(joined(waiting), backend, now - begun))
            waiting, begun = [], now
        progress("episodes", there + done, there + count)


def simulate_on_workers(work: Work, kept: KeptEvaluation, open_engine: OpenEngine, progress: Progress) -> None:
    """Simulate in the engine's workers and keep each part as it ends.

    Raises:
        TasksFailedError: a part failed for good; the others are kept.
    """
    count, there = len(work.episodes), work.experiment.evaluation.episodes - len(work.episodes)
    work = work._replace(parameters=jax.tree.map(np.asarray, work.parameters))
    failures = []
    done, begun = 0, time.perf_counter()
    with open_engine() as engine:
        parts = [work.part(rows) for rows in split(count, engine.workers)]
        for position, result in engine.map(simulate_part, parts, time_limit_s=PART_TIME_LIMIT_S):
            if isinstance(result, TaskFailure):
                failures.append(f"episodes from {parts[position].episodes[0]}: {result.cause}")
                continue
            for episode, trace in result.unstable.items():
                kept.add_unstable(episode, trace)
            for episode, trace in result.traces.items():
                kept.add_trace(episode, trace)
            size, now = len(parts[position].episodes), time.perf_counter()
            kept.add(result.rows | {"wall": np.full(size, (now - begun) / size)})
            begun, done = now, done + size
            progress("episodes", there + done, there + count)
    if failures:
        raise TasksFailedError(
            f"{len(failures)} parts of the evaluation failed ({'; '.join(sorted(failures))}); "
            "the others are kept, and the same command tries again"
        )


def split(count: int, workers: int) -> list[slice]:
    """Parts for the workers: as long as may be, so that fewer slots wait for the last episode, but several for each."""
    files = -(-count // FILE)
    size = min(LONGEST_PART, FILE * max(1, files // (PARTS_A_WORKER * workers)))
    return [slice(first, first + size) for first in range(0, count, size)]


_BACKENDS: dict[tuple[str, int], Backend] = {}  # of this worker, the last one: compiling takes longer than a part


@on_one_blas_thread
def simulate_part(work: Work) -> PartResult:
    """Simulate a part on one core. Runs in a worker."""
    batch, begun = work.slots, time.perf_counter()
    if (work.key, batch) not in _BACKENDS:
        _BACKENDS.clear()
        _BACKENDS[work.key, batch] = make_backend(work.experiment, work.parameters, batch, 1)
    backend = _BACKENDS[work.key, batch]
    recorder = Recorder(backend.slots, work.traced)
    ended = list(simulate(backend, work, recorder))
    unstable = {int(one.row["episode"][0]): one.last_second for one in ended if one.last_second is not None}
    rows = _with_measures(joined([one.row for one in ended]), backend, time.perf_counter() - begun)
    return PartResult(rows, _traces(work, backend, recorder), unstable)


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
        "min_self_clearance": outcome.min_self_clearance,
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


def _traces(work: Work, backend: Backend, recorder: Recorder) -> dict[int, Trace]:
    traces = recorder.traces(make_scene(work.experiment.scene), backend.plan_dt)
    return dict(zip(work.episodes[: len(traces)].tolist(), traces, strict=True))


def _with_measures(rows: Columns, backend: Backend, seconds: float) -> Columns:
    """The rows with what is measured of all of them: an episode's share of the time [s], and where it ran."""
    count = len(rows["episode"])
    measures = {"wall": seconds / count, "device": backend.device, "query_seconds": backend.query_seconds()}
    return rows | {name: np.full(count, value) for name, value in measures.items()}
