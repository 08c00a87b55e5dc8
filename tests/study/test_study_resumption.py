"""A real study, small: killed in its second value, it keeps the first, and tells of both in the end."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from agile_jax.cli import main
from agile_jax.experiment import load_experiment
from agile_jax.report.figures.study_figures import draw_success
from agile_jax.report.figures.style import new_axes
from agile_jax.store.npz import read_npz
from agile_jax.study import list_values
from agile_jax.study.rows import to_curves
from agile_jax.sweep.execute import wait_until_free

ROOT = pathlib.Path(__file__).parents[2]
TEXT = f"""
extends = "{ROOT / "experiments/base.toml"}"
name = "small"
[expert]
nodes = 30
[scene]
target = [2.2, 0.0, 0.28, 0.0]
[scene.start]
mean = [0.8, 0.0, 0.28, 0.0]
std = [0.02, 0.05, 0.0, 0.0]
[evaluation]
planner = "open_loop"
episodes = 2
batch = 2
traced = 0
[study]
vary = ["plant.joint_damping", "plant.joint_friction"] # no part of what is compiled
values = [1.0, 0.0]
label = "damping and friction of the joints"
"""
COMMAND = [sys.executable, "-m", "agile_jax.cli", "study", "small.toml", "--engine", "inline"]


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A folder with a study that was killed as soon as its first value was done."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "small.toml").write_text(TEXT)
    process = subprocess.Popen(COMMAND, cwd=folder, env=environment(), stderr=subprocess.DEVNULL)
    record, deadline = folder / "runs/small/study.json", time.monotonic() + 600
    while process.poll() is None and time.monotonic() < deadline:
        if record.is_file() and "done" in [row["status"] for row in json.loads(record.read_bytes())["rows"]]:
            break
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    assert process.wait(60) == -signal.SIGKILL
    for trial in (folder / "runs/small/trials").iterdir():
        wait_until_free(trial)  # the value's process ends with the study, even with a killed one
    return folder


def environment() -> dict[str, str]:
    return os.environ | {"JAX_COMPILATION_CACHE_DIR": str(ROOT / ".pytest_cache/jax"), "JAX_PLATFORMS": "cpu"}


def times(folder: pathlib.Path) -> dict[pathlib.Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


@pytest.mark.slow
def test_killed_and_resumed(
    killed: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    directory = killed / "runs/small"
    experiment = load_experiment(killed / "small.toml")
    values = {trial.values["plant.joint_damping"]: trial for trial in list_values(experiment, directory)}
    assert (values[0.0].status, values[1.0].status) == ("done", "new")  # in increasing order
    made = times(values[0.0].run_dir)
    again = subprocess.run(COMMAND, cwd=killed, env=environment(), capture_output=True, text=True, timeout=600)
    assert again.returncode == 0, again.stderr
    assert times(values[0.0].run_dir) == made
    assert again.stdout.count(" done") == 2

    study = json.loads((directory / "study.json").read_bytes())
    fallen, walked = study["rows"]
    assert (fallen["value"], walked["value"]) == (0.0, 1.0)
    assert walked["success_rate"] == 1.0 > fallen["success_rate"]  # undamped joints: the controller falls
    assert walked["starts_under"] == fallen["starts_under"] == 2
    for row in study["rows"]:
        episodes = read_npz(directory / row["run_dir"] / "evaluation/mujoco.npz")
        assert row["success_rate"] == episodes["success"].mean()
        assert row["min_clearance_m_median"] == pytest.approx(np.median(episodes["min_clearance"]))
        assert row["min_clearance_m_p05"] == pytest.approx(np.quantile(episodes["min_clearance"], 0.05))
    assert experiment.study is not None
    drawn = draw_success(new_axes(), to_curves(experiment.study, study["rows"])).lines[0]
    assert drawn.get_ydata().tolist() == [fallen["success_rate"], walked["success_rate"]]

    files = {name: (directory / name).read_bytes() for name in ("study.json", "study.csv", "study.png", "study.html")}
    assert b'src="data:image/png' in files["study.html"]
    kept = times(directory / "trials")
    monkeypatch.chdir(killed)
    capsys.readouterr()
    assert main(["study", "runs/small"]) == 0
    assert times(directory / "trials") == kept
    assert files == {name: (directory / name).read_bytes() for name in files}
    assert main(["status", "runs/small"]) == 0
    assert capsys.readouterr().out.count(" done") == 4
