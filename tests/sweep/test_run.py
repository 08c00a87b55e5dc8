"""Real sweeps over real (small) datasets: sharing, failures, kills. The metric is of the dataset: no JAX is needed."""

import json
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from agile_jax.experiment import Experiment, load_experiment, with_overrides
from agile_jax.sweep import list_trials, run_sweep
from agile_jax.sweep.execute import wait_until_free

BASE = pathlib.Path(__file__).parents[2] / "experiments" / "base.toml"
SMALL = {"dataset.trajectories": 2, "dataset.shard_size": 1, "expert.nodes": 20, "name": "s"}


def sweep(space: dict[str, list], metric: str = "dataset.optimality_gap_median") -> Experiment:
    experiment = load_experiment(BASE, SMALL)
    return with_overrides(experiment, {"sweep": {"space": space, "metric": metric}}, "test")


def test_equal_stages_are_shared_and_finished_trials_skipped(tmp_path: pathlib.Path) -> None:
    experiment = sweep({"training.learning_rate": [0.1, 0.2], "expert.nodes": [20, 30]})
    assert [trial.status for trial in list_trials(experiment, tmp_path)] == ["new"] * 4
    assert list(tmp_path.iterdir()) == []
    trials = run_sweep(experiment, tmp_path, engine="inline")
    assert [trial.status for trial in trials] == ["done"] * 4
    assert len(list((tmp_path / "stages").iterdir())) == 2  # one dataset for each number of nodes
    folders = [(trial.run_dir / "dataset").resolve() for trial in trials]
    assert folders[0] == folders[2] != folders[1] == folders[3]
    record = json.loads((tmp_path / "sweep.json").read_text())
    assert [entry["status"] for entry in record["trials"]] == ["done"] * 4
    for entry, trial in zip(record["trials"], trials, strict=True):
        summary = json.loads((tmp_path / entry["run_dir"] / "dataset/summary.json").read_text())
        assert entry["metric"] == trial.metric == summary["optimality_gap_median"]
    assert record["best"] == min(record["trials"], key=lambda entry: entry["metric"])["hash"]

    logs = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file() and path.name != ".lock"}
    again = run_sweep(experiment, tmp_path, engine="inline")
    assert again == trials
    changed = {path.name for path, time in logs.items() if path.stat().st_mtime_ns != time}
    assert changed <= {"sweep.json"}


def test_a_failed_trial_is_recorded_and_the_sweep_goes_on(tmp_path: pathlib.Path) -> None:
    experiment = sweep({"seed": [0, 1]})
    taken = list_trials(experiment, tmp_path)[0].run_dir / "dataset/thesis.txt"  # somebody's, in a stage's place
    taken.parent.mkdir(parents=True)
    taken.touch()
    failed, done = run_sweep(experiment, tmp_path, engine="inline")
    assert (failed.status, done.status) == ("failed", "done")
    assert "to move the old folder aside" in failed.cause
    assert taken.exists()
    assert failed.metric is None
    record = json.loads((tmp_path / "sweep.json").read_text())
    assert record["trials"][0]["cause"] == failed.cause
    assert [trial.status for trial in list_trials(experiment, tmp_path)] == ["failed", "done"]


def test_a_metric_that_is_not_there_is_a_named_failure(tmp_path: pathlib.Path) -> None:
    (trial,) = run_sweep(sweep({"seed": [0]}, "dataset.branches.nowhere"), tmp_path, engine="inline")
    assert trial.status == "failed"
    assert "has no branches.nowhere; it has " in trial.cause


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_killed_and_resumed(number: signal.Signals, tmp_path: pathlib.Path) -> None:
    (tmp_path / "s.toml").write_text(
        f'extends = "{BASE}"\nname = "s"\n[dataset]\ntrajectories = 40\nshard_size = 1\n[expert]\nnodes = 20\n'
        '[sweep]\nmetric = "dataset.optimality_gap_median"\n[sweep.space]\n"expert.nodes" = [20, 30]\n'
    )
    command = [sys.executable, "-m", "agile_jax.cli", "sweep", "s.toml", "--engine", "inline"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    shared = tmp_path / "runs/s/stages"
    while not list(shared.glob("*/shard-*.npz")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(number)
    assert process.wait(60) in (-signal.SIGKILL, 143)
    (folder,) = shared.iterdir()  # the first trial's; the second had not begun
    (trial_dir,) = (tmp_path / "runs/s/trials").iterdir()
    wait_until_free(trial_dir)  # the trial's process ends with the sweep, even with a killed one
    assert 0 < len(list(folder.glob("shard-*.npz"))) < 40
    written = {path: path.stat().st_mtime_ns for path in folder.glob("shard-*.npz")}

    again = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert again.returncode == 0, again.stderr
    assert again.stdout.count(" done") == 2
    assert all(path.stat().st_mtime_ns == time for path, time in written.items())
    assert len(list(folder.glob("shard-*.npz"))) == 40
