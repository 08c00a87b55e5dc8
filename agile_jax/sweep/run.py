"""Running a sweep: one process a trial, one folder for each distinct dataset and training (execute.py).

The record of a sweep is plain files: `sweep.json` is written anew from the trials' run directories after every trial.
A grid needs no study database: its points are known beforehand and independent, so there is no sampler state to keep,
and a database would be a second truth that a kill can part from the first.
"""

import pathlib
from collections.abc import Sequence
from functools import partial

from agile_jax.experiment import Experiment
from agile_jax.files import read_json, write_json
from agile_jax.progress import Progress, silent
from agile_jax.sweep.execute import recall, run_trials
from agile_jax.sweep.settings import SweepSettings
from agile_jax.sweep.trials import Trial, best, make_trials, read_number, sweep_settings


def list_trials(experiment: Experiment, sweep_dir: pathlib.Path) -> list[Trial]:
    """The trials with what is known of them; runs nothing and writes nothing."""
    entries = (read_json(sweep_dir / "sweep.json") or {}).get("trials")
    return recall(make_trials(experiment, sweep_dir), entries, partial(_judged, sweep_settings(experiment)))


def run_sweep(
    experiment: Experiment,
    sweep_dir: pathlib.Path,
    *,
    engine: str = "local",
    workers: int | None = None,
    progress: Progress = silent,
) -> list[Trial]:
    """Run every trial that is not done. One that fails is recorded with its cause; the next sweep tries it again.

    Args:
        experiment: with a [sweep] table; every point is validated before the first trial starts.
        sweep_dir: made if missing; held alone while this runs.
        engine: address of the work engine that each trial uses.
        workers: processes of a local engine.
        progress: is told of the trials that have ended.

    Raises:
        BadInput: the sweep or one of its points is not valid, or another process is at work in the folder.
    """
    return run_trials(
        experiment,
        list_trials(experiment, sweep_dir),
        sweep_dir,
        partial(_judged, sweep_settings(experiment)),
        partial(_write_results, experiment, sweep_dir),
        engine=engine,
        workers=workers,
        progress=progress,
    )


def _judged(settings: SweepSettings, trial: Trial) -> Trial:
    metric = read_number(settings.metric, trial.run_dir)
    if metric.value is None:
        return trial._replace(status="failed", cause=metric.cause)
    shown = tuple(read_number(key, trial.run_dir).value for key in settings.show)
    return trial._replace(status="done", metric=metric.value, shown=shown, cause="")


def _write_results(experiment: Experiment, sweep_dir: pathlib.Path, trials: Sequence[Trial]) -> None:
    settings = sweep_settings(experiment)
    winner = best(settings, trials)
    entries: list[dict[str, object]] = [
        {
            "hash": trial.hash,
            "values": trial.values,
            "run_dir": str(trial.run_dir.relative_to(sweep_dir)),
            "status": trial.status,
            "metric": trial.metric,
            "shown": dict(zip(settings.show, trial.shown, strict=bool(trial.shown))),
            "cause": trial.cause,
            "seconds": trial.seconds,
        }
        for trial in trials
    ]
    write_json(
        sweep_dir / "sweep.json",
        {
            "name": experiment.name,
            "metric": settings.metric,
            "direction": settings.direction,
            "best": winner.hash if winner else None,
            "trials": entries,
        },
    )
