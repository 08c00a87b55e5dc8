"""Running trials one after the other, each in a process of its own, which keeps JAX apart; equal stages are shared.

A trial is done when its run directory says so (the same rule as for any run). One that fails is recorded with its
cause; the next command tries it again.

    <folder>/experiment.toml                    with the table that says what varies
    <folder>/trials/<hash12>/                   a run directory; its dataset and training are links to
    <folder>/stages/<stage>-<hash12>/           what all trials with equal settings share
"""

import os
import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

from agile_jax.experiment import Experiment, to_toml
from agile_jax.files import hash_json, write_atomic
from agile_jax.progress import Progress
from agile_jax.run_directory import begun_record, locked, stage_state
from agile_jax.settings import BadInput
from agile_jax.sweep.trials import Trial, point_text

Judge = Callable[[Trial], Trial]  # of a trial whose stages are done: with its status and numbers
SHARED = ("dataset", "training")
ORPHAN_TIME = 60.0  # [s] for a trial's process that has lost its sweep, to end
END_TIME = 20.0  # [s] for a trial's process to end after SIGTERM


def recall(trials: Sequence[Trial], entries: object, judge: Judge) -> list[Trial]:
    """The trials with what is known of them: from their run directories, and of failures from a record's entries."""
    listed = entries if isinstance(entries, list) else []
    before = {entry["hash"]: entry for entry in listed if isinstance(entry, dict) and "hash" in entry}
    found = []
    for trial in trials:
        known = before.get(trial.hash, {})
        trial = trial._replace(seconds=float(known.get("seconds", 0.0)))
        if _finished(trial):
            trial = judge(trial)
        elif known.get("status") == "failed":
            trial = trial._replace(status="failed", cause=str(known.get("cause", "")))
        found.append(trial)
    return found


def run_trials(
    experiment: Experiment,
    trials: Sequence[Trial],
    folder: pathlib.Path,
    judge: Judge,
    publish: Callable[[Sequence[Trial]], None],
    *,
    engine: str,
    workers: int | None,
    progress: Progress,
) -> list[Trial]:
    """Run every trial that is not done.

    Args:
        experiment: of which they are trials; kept in the folder.
        trials: from `recall`.
        folder: of their run directories; made if missing, and held alone while this runs.
        judge: of a trial whose stages are done.
        publish: writes what is known of the trials; called before the first and after each.
        engine: address of the work engine that each trial uses.
        workers: processes of a local engine.
        progress: is told of the trials that have ended.

    Raises:
        BadInput: another process is at work in the folder.
    """
    trials = list(trials)
    about, path = to_toml(experiment).encode(), folder / "experiment.toml"
    with locked(folder):
        if not path.is_file() or path.read_bytes() != about:
            write_atomic(path, about)
        publish(trials)
        for number, trial in enumerate(trials):
            if not _finished(trial):
                varied = point_text(trial.values)
                progress("trials", number, len(trials), f"{varied} (log in {trial.run_dir / 'log.txt'})")
                began = time.monotonic()
                cause = _run(trial, folder, engine, workers)
                ended = trial._replace(cause=cause, seconds=time.monotonic() - began)
                trials[number] = ended._replace(status="failed") if cause else judge(ended)
                publish(trials)
            progress("trials", number + 1, len(trials))
    return trials


def _finished(trial: Trial) -> bool:
    return all(stage_state(trial.run_dir, trial.experiment, stage) == "done" for stage in trial.stages)


def _run(trial: Trial, folder: pathlib.Path, engine: str, workers: int | None) -> str:
    """Run one trial in a process of its own. Returns the cause of a failure, or ""."""
    try:
        wait_until_free(trial.run_dir)
    except BadInput as error:
        return str(error)
    for stage in set(SHARED) & set(trial.stages):
        _share(trial, stage, folder)
    write_atomic(trial.run_dir / "experiment.toml", to_toml(trial.experiment).encode())
    log = trial.run_dir / "log.txt"
    command = [sys.executable, "-m", "agile_jax.sweep.trial", str(trial.run_dir), ",".join(trial.stages), engine]
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


def _share(trial: Trial, stage: str, folder: pathlib.Path) -> None:
    """Make the trial's stage folder a link to the one that all trials with an equal stage share."""
    wanted = begun_record(trial.run_dir, trial.experiment, stage)
    home = folder / "stages" / f"{stage}-{hash_json([wanted.key, wanted.amounts])[:12]}"
    home.mkdir(parents=True, exist_ok=True)
    link = trial.run_dir / stage
    if not link.is_symlink() and not link.exists():
        link.symlink_to(os.path.relpath(home, trial.run_dir), target_is_directory=True)
