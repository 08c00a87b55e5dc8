"""The stage `evaluation`: starts, the expert's times from them, episodes of the closed loop, summary.

Episodes are kept under the key of what they depend on (kept.py). So a killed evaluation goes on with those that are
missing, more episodes keep those that are there, and other settings make another evaluation beside this one.
"""

import hashlib
import os
import pathlib

import jax
import numpy as np
from jaxtyping import Float, Int, PyTree

from agile_jax.dataset import expert_times, rejected_shares, time_limit, unseen_starts
from agile_jax.evaluation.backend import command_parameters
from agile_jax.evaluation.breakdown import distributions, outcomes_by_region
from agile_jax.evaluation.episodes import Work, simulate_here, simulate_on_workers
from agile_jax.evaluation.kept import Columns, KeptEvaluation
from agile_jax.evaluation.summary import summarise
from agile_jax.experiment import Experiment
from agile_jax.progress import Progress, silent
from agile_jax.robot import load_robot, robot_digest
from agile_jax.scene import clearance, make_scene, streams
from agile_jax.simulation import push_after
from agile_jax.store.artefact import EPISODES, key
from agile_jax.store.parts import OpenEngine


def evaluation_starts(experiment: Experiment) -> Float[np.ndarray, "episodes 4"]:
    """Start poses that no training has seen [m, rad]; start i does not depend on how many there are."""
    return unseen_starts(experiment.scene, experiment.expert, experiment.evaluation.episodes, _stream(experiment))


def _stream(experiment: Experiment) -> tuple[int, ...]:
    return experiment.seed, streams.EVALUATION_STARTS, experiment.evaluation.seed


def episodes_key(experiment: Experiment, parameters: PyTree) -> str:
    """The key of the episodes with these parameters of what the controller follows."""
    digest = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(parameters):
        values = np.asarray(leaf)
        digest.update(f"{jax.tree_util.keystr(path)} {values.shape} {values.dtype.str}".encode())
        digest.update(values.tobytes())
    robot = robot_digest(experiment.robot)
    foreign = {} if robot is None else {"robot": robot}
    return key(EPISODES, experiment.model_dump(mode="json"), {"epochs": digest.hexdigest()}, foreign)


def evaluate(
    experiment: Experiment, run_dir: pathlib.Path, open_engine: OpenEngine, progress: Progress = silent
) -> dict[str, object]:
    """Simulate the episodes that are missing and write `evaluation/<backend>.json`, `.npz` and `-traces.npz`.

    Args:
        experiment: all settings.
        run_dir: holds `training/`.
        open_engine: opens the work engine for the expert's times, and for the episodes with `where` = "workers".
        progress: is told of expert times and episodes.

    Returns:
        The summary, with the keys of the run directory's contract.

    Raises:
        TasksFailedError: a worker failed for good; what was simulated is kept.
    """
    settings, folder = experiment.evaluation, run_dir / "evaluation"
    parameters = command_parameters(experiment, run_dir / "training")
    kept = KeptEvaluation(folder, episodes_key(experiment, parameters))
    starts = evaluation_starts(experiment)
    expert = expert_times(experiment.scene, experiment.expert, starts, open_engine, folder / "expert-times", progress)
    limits = time_limit(expert.duration)

    missing = missing_episodes(kept, settings.episodes, settings.traced)
    if len(missing):
        traced = int(np.searchsorted(missing, settings.traced))
        pushed = push_after(expert.duration, expert.branch)
        work = Work(
            kept.key, experiment, parameters, missing, starts[missing], limits[missing], pushed[missing], traced
        )
        if settings.where == "workers":
            simulate_on_workers(work, kept, open_engine, progress)
        else:
            simulate_here(work, kept, settings.threads or own_cores(), progress)

    columns = {name: values[: settings.episodes] for name, values in kept.rows().items() if name != "episode"}
    measures = {name: columns.pop(name) for name in ("wall", "device", "query_seconds")}
    columns |= {
        "start": starts,
        "time_limit": limits,
        "expert_time": expert.duration,
        "expert_arrival_time": expert.arrival,
        "branch": np.array(expert.branch),
    }
    summary = summary_of(experiment, columns, measures) | {"evaluation_key": kept.key}
    traces = [trace for i in range(settings.traced) if (trace := kept.trace(i)) is not None]
    kept.publish(settings.backend, settings.name, columns, summary, traces)
    return summary


def own_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def missing_episodes(kept: KeptEvaluation, count: int, traced: int) -> Int[np.ndarray, " n"]:
    """The numbers of the episodes to simulate: those without a row, and those to be recorded that are not."""
    there = set(kept.rows()["episode"].tolist())
    lacks = (i not in there or (i < traced and kept.trace(i) is None) for i in range(count))
    return np.flatnonzero(np.fromiter(lacks, bool, count))


def summary_of(experiment: Experiment, columns: Columns, measures: Columns) -> dict[str, object]:
    """The summary of episodes.

    Args:
        experiment: with which they were simulated.
        columns: one entry an episode.
        measures: `wall`, an episode's share of the time [s]; `device`; `query_seconds`, of the planner [s].
    """
    scene, robot = make_scene(experiment.scene), load_robot(experiment.robot)
    return {
        "backend": experiment.evaluation.backend,
        "device": str(measures["device"][-1]),
        "planner": experiment.evaluation.planner,
        "planning_ms_per_query_median": 1e3 * float(np.median(measures["query_seconds"])),
        **rejected_shares(experiment.scene, experiment.expert, _stream(experiment)),
        **summarise(columns, experiment.control, float(measures["wall"].sum())),
        **distributions(columns, float(robot.link_masses.sum())),
        "outcomes_by_region": outcomes_by_region(columns, np.asarray(clearance(scene, columns["start"]))),
    }
