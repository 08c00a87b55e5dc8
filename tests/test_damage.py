"""A finished training that is damaged afterwards: nothing uses it, and the same command repairs it.

See also tests/test_pipeline.py, of the last checkpoint.
"""

import json
import pathlib
import shutil
from collections.abc import Callable

import numpy as np
import pytest

from agile_jax import pipeline
from agile_jax.api.run import open_run
from agile_jax.experiment import Experiment, load_experiment, with_overrides
from agile_jax.run_directory import stage_state
from agile_jax.settings import BadInput

BASE = pathlib.Path(__file__).parents[1] / "experiments" / "base.toml"
TINY = {
    "dataset.trajectories": 20,
    "expert.nodes": 20,
    "expert.initial_velocity": "free",
    "policy.hidden_layers": [8],
    "training.batch_size": 64,
    "training.epochs": 3,
    "training.checkpoint_every": 1,
    "training.schedule": "constant",
    "kinematic_test.starts": 4,
    "kinematic_test.every": 0,
}


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return load_experiment(BASE, TINY)


@pytest.fixture(scope="module")
def finished(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    run_dir = tmp_path_factory.mktemp("runs") / "finished"
    pipeline.run(experiment, run_dir, ("dataset", "training"), engine="inline", store="none")
    return run_dir


DAMAGE: dict[str, Callable[[pathlib.Path], None]] = {
    "all checkpoints are gone": lambda run: shutil.rmtree(run / "training/checkpoints"),
    "a digit of the summary": lambda run: digit(run / "training/summary.json"),
    "the record": lambda run: digit(run / "training/stage.json"),
}


def digit(path: pathlib.Path) -> None:
    text = path.read_text()
    place = text.index('"test_mse": ') + 14 if '"test_mse": ' in text else text.index("0")
    path.write_text(
        text[:place] + str((int(text[place]) + 1) % 10) + text[place + 1 :] if text[place].isdigit() else ""
    )


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_to_a_finished_training_is_not_used_and_repaired(
    experiment: Experiment, finished: pathlib.Path, tmp_path: pathlib.Path, damage: str
) -> None:
    run_dir = shutil.copytree(finished, tmp_path / "run")
    summary = json.loads((run_dir / "training/summary.json").read_text())
    pose = np.array([1.0, 0.2, 0.2, 0.1])
    velocity = np.asarray(open_run(run_dir).policy(pose))
    DAMAGE[damage](run_dir)
    assert stage_state(run_dir, experiment, "training") in ("begun", "new")
    with pytest.raises(BadInput, match="its training is not finished"):
        _ = open_run(run_dir).policy
    pipeline.run(experiment, run_dir, ("dataset", "training"), engine="inline", store="none")
    assert stage_state(run_dir, experiment, "training") == "done"
    np.testing.assert_array_equal(np.asarray(open_run(run_dir).policy(pose)), velocity)
    again = json.loads((run_dir / "training/summary.json").read_text())
    clocks = {"seconds", "compile_seconds"}
    assert {name: again[name] for name in again.keys() - clocks} == {
        name: summary[name] for name in summary.keys() - clocks
    }
    if damage == "a digit of the summary":
        assert again == summary


def test_more_epochs_of_a_constant_rate_go_on_and_fewer_are_refused(
    experiment: Experiment, finished: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    run_dir = shutil.copytree(finished, tmp_path / "run")
    fewer = with_overrides(experiment, {"training.epochs": 2}, "test")
    with pytest.raises(BadInput, match=r"training\.epochs: 3 there, 2 asked for"):
        pipeline.run(fewer, run_dir, ("dataset", "training"), engine="inline", store="none")
    more = with_overrides(experiment, {"training.epochs": 4, "kinematic_test.starts": 6}, "test")
    rows = (run_dir / "training/metrics.jsonl").read_text()
    summary = pipeline.run(more, run_dir, ("dataset", "training"), engine="inline", store="none")["training"].summary
    assert (summary["epochs"], summary["field_starts"]) == (4, 6)
    assert (run_dir / "training/metrics.jsonl").read_text().startswith(rows)


def test_a_report_never_tells_a_damaged_number(finished_run: pathlib.Path, tmp_path: pathlib.Path) -> None:
    run_dir = shutil.copytree(finished_run, tmp_path / "run")
    experiment = load_experiment(run_dir / "experiment.toml")
    path, told = run_dir / "evaluation/mujoco.json", (run_dir / "report.html").read_text()
    sound, episodes = path.read_bytes(), (run_dir / "evaluation/mujoco.npz").read_bytes()
    path.write_text(json.dumps(json.loads(sound) | {"success_rate": 0.125}))
    (run_dir / "report.html").unlink()
    assert stage_state(run_dir, experiment, "evaluation") == "begun"
    (run_dir / "evaluation/mujoco.npz").write_bytes(episodes[:-50] + b"?" + episodes[-49:])
    with pytest.raises(BadInput, match=r"its evaluation is damaged .*mujoco\.npz.*`agile run .*` repairs it"):
        pipeline.run(experiment, run_dir, ("report",), engine="inline")
    assert not (run_dir / "report.html").exists()
    (run_dir / "evaluation/mujoco.npz").write_bytes(episodes)
    pipeline.run(experiment, run_dir, ("report",), engine="inline")
    assert path.read_bytes() == sound
    assert (run_dir / "report.html").read_text() == told
    assert "<b>12.5 %</b>" not in told


def test_another_evaluation_keeps_the_first_and_marks_the_report(
    finished_run: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    run_dir = shutil.copytree(finished_run, tmp_path / "run")
    experiment = load_experiment(run_dir / "experiment.toml")
    kept = {path: path.read_bytes() for path in run_dir.glob("evaluation/kept/*/*.npz")}
    assert kept
    other = with_overrides(experiment, {"evaluation.seed": 5, "evaluation.episodes": 1}, "test")
    assert "will tell of it instead" in pipeline.forecast(other, run_dir, ("evaluation",))["evaluation"]
    pipeline.run(other, run_dir, ("evaluation",), engine="inline")
    assert {path: path.read_bytes() for path in kept} == kept
    marked = "since it was written, evaluation/mujoco.json changed"
    assert marked in (run_dir / "report.html").read_text()
    pipeline.run(experiment, run_dir, ("evaluation",), engine="inline")  # nothing is simulated
    assert marked not in (run_dir / "report.html").read_text()
