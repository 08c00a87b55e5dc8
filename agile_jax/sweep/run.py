"""Running a sweep: one process a trial, one folder for each distinct dataset and training.

The record of a sweep is plain files: a trial is done when its run directory says so (the same rule as for any run),
and `sweep.json` is written anew from them after every trial. A grid needs no study database: its points are known
beforehand and independent, so there is no sampler state to keep, and a database would be a second truth that a kill
can part from the first.

    <sweep_dir>/sweep.json                         results
    <sweep_dir>/trials/<hash12>/                   a run directory; its dataset and training are links to
    <sweep_dir>/stages/<stage>-<hash12>/           what all trials with equal settings share
"""

import os
import pathlib
import signal
import subprocess
import sys
import time

from agile_jax.experiment import Experiment, to_toml
from agile_jax.files import hash_json, read_json, write_atomic, write_json
from agile_jax.progress import Progress, silent
from agile_jax.run_directory import begun_record, locked, stage_state
from agile_jax.settings import BadInput
from agile_jax.sweep.settings import SweepSettings
from agile_jax.sweep.trials import (
    Trial,
    best,
    make_trials,
    point_text,
    read_number,
    stages_for,
    sweep_settings,
)

SHARED = ("dataset", "training")
ORPHAN_TIME = 60.0  # [s] for a trial's process that has lost its sweep, to end
END_TIME = 20.0  # [s] for a trial's process to end after SIGTERM


def list_trials(experiment: Experiment, sweep_dir: pathlib.Path) -> list[Trial]:
    """The trials with what is known of them; runs nothing and writes nothing."""
    settings = sweep_settings(experiment)
    recorded = (read_json(sweep_dir / "sweep.json") or {}).get("trials")
    entries = recorded if isinstance(recorded, list) else []
    before = {entry["hash"]: entry for entry in entries if isinstance(entry, dict) and "hash" in entry}
    trials = []
    for trial in make_trials(experiment, sweep_dir):
        known = before.get(trial.hash, {})
        seconds = float(known.get("seconds", 0.0))
        if _finished(trial, settings):
            trial = _judged(trial, settings, seconds)
        elif known.get("status") == "failed":
            trial = trial._replace(status="failed", cause=str(known.get("cause", "")), seconds=seconds)
        trials.append(trial)
    return trials


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
    settings = sweep_settings(experiment)
    trials = list_trials(experiment, sweep_dir)
    with locked(sweep_dir):
        _write_results(experiment, sweep_dir, trials)
        for number, trial in enumerate(trials):
            if not _finished(trial, settings):
                varied = point_text(trial.values)
                progress("trials", number, len(trials), f"{varied} (log in {trial.run_dir / 'log.txt'})")
                began = time.monotonic()
                cause = _run_trial(trial, settings, sweep_dir, engine, workers)
                seconds = time.monotonic() - began
                if cause:
                    trials[number] = trial._replace(status="failed", cause=cause, seconds=seconds)
                else:
                    trials[number] = _judged(trial, settings, seconds)
                _write_results(experiment, sweep_dir, trials)
            progress("trials", number + 1, len(trials))
    return trials


def _finished(trial: Trial, settings: SweepSettings) -> bool:
    return all(stage_state(trial.run_dir, trial.experiment, stage) == "done" for stage in stages_for(settings))


def _judged(trial: Trial, settings: SweepSettings, seconds: float) -> Trial:
    metric = read_number(settings.metric, trial.run_dir)
    if metric.value is None:
        return trial._replace(status="failed", cause=metric.cause, seconds=seconds)
    shown = tuple(read_number(key, trial.run_dir).value for key in settings.show)
    return trial._replace(status="done", metric=metric.value, shown=shown, cause="", seconds=seconds)


def _run_trial(trial: Trial, settings: SweepSettings, sweep_dir: pathlib.Path, engine: str, workers: int | None) -> str:
    """Run one trial in a process of its own, which keeps JAX apart. Returns the cause of a failure, or ""."""
    try:
        wait_until_free(trial.run_dir)
    except BadInput as error:
        return str(error)
    stages = stages_for(settings)
    for stage in set(SHARED) & set(stages):
        _share(trial, stage, sweep_dir)
    write_atomic(trial.run_dir / "experiment.toml", to_toml(trial.experiment).encode())
    log = trial.run_dir / "log.txt"
    command = [sys.executable, "-m", "agile_jax.sweep.trial", str(trial.run_dir), ",".join(stages), engine]
    with open(log, "w") as output:
        process = subprocess.Popen(
            command if workers is None else [*command, str(workers)],
            stdin=subprocess.PIPE,  # its end tells the trial that the sweep has died
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            code = process.wait()
        except BaseException:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(END_TIME)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            raise
        finally:
            if process.stdin is not None:
                process.stdin.close()
    if code == 0:
        return ""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1] if lines else f"exit code {code}"


def wait_until_free(run_dir: pathlib.Path) -> None:
    """Wait for the process of a killed sweep that has not yet noticed; BadInput when it stays."""
    deadline = time.monotonic() + ORPHAN_TIME
    while True:
        try:
            with locked(run_dir):
                return
        except BadInput:
            if time.monotonic() > deadline:
                raise
        time.sleep(0.2)


def _share(trial: Trial, stage: str, sweep_dir: pathlib.Path) -> None:
    """Make the trial's stage folder a link to the one that all trials with an equal stage share."""
    wanted = begun_record(trial.run_dir, trial.experiment, stage)
    home = sweep_dir / "stages" / f"{stage}-{hash_json([wanted.key, wanted.amounts])[:12]}"
    home.mkdir(parents=True, exist_ok=True)
    link = trial.run_dir / stage
    if not link.is_symlink() and not link.exists():
        link.symlink_to(os.path.relpath(home, trial.run_dir), target_is_directory=True)


def _write_results(experiment: Experiment, sweep_dir: pathlib.Path, trials: list[Trial]) -> None:
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
