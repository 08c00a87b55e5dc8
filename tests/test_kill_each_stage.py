"""A run that is killed again and again, in every stage, ends as one that was left alone: bit for bit.

All of it is real: the command as a user types it, SIGKILL, and the same command again.
"""

import json
import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import jax
import numpy as np
import pytest

from agile_jax.experiment import load_experiment
from agile_jax.policy import make_policy
from agile_jax.scene import make_scene
from agile_jax.training.checkpoint import load_parameters

SMOKE = pathlib.Path(__file__).parents[1] / "experiments" / "smoke.toml"
OPTIONS = ["--dataset.shard-size", "4", "--training.checkpoint-every", "2", "--evaluation.batch", "2", "--workers", "2"]
PATIENCE = 300.0  # [s] for a moment to come


def older(path: pathlib.Path, seconds: float) -> bool:
    """Whether a file has been there for some time."""
    return path.exists() and time.time() - path.stat().st_mtime > seconds


MOMENTS: dict[str, Callable[[pathlib.Path], bool]] = {  # in the order in which they come
    "the dataset has begun": lambda run: (run / "dataset/stage.json").exists(),
    "some shards are there": lambda run: len(list(run.glob("dataset/shard-*.npz"))) >= 2,
    "the training has begun": lambda run: (run / "training/stage.json").exists(),
    "a checkpoint is being written": lambda run: any(run.glob("training/checkpoints/*tmp*")),
    "a checkpoint is there without its hashes": lambda run: any(
        path.name.isdigit() and not (path / "integrity.json").exists() for path in run.glob("training/checkpoints/*")
    ),
    "some epochs are done": lambda run: any(run.glob("training/checkpoints/1?/integrity.json")),
    "the field is being judged": lambda run: any(run.glob("training/checkpoints/20/integrity.json")),
    "the expert times the starts": lambda run: older(run / "training/summary.json", 0.7),
    "the episodes run": lambda run: any(older(path, 3.0) for path in run.glob("evaluation/expert-times/part-*.npz")),
    "some episodes are done": lambda run: any(run.glob("evaluation/kept/*/episodes-*.npz")),
    "the report has begun": lambda run: (run / "figures/stage.json").exists(),
    "the report draws": lambda run: any(run.glob("figures/outcomes_*.png")),
    "the video is encoded": lambda run: any(run.glob("videos/.*.tmp")),
}


def command(run_dir: pathlib.Path, options: list[str], experiment: pathlib.Path = SMOKE) -> list[str]:
    return [sys.executable, "-m", "agile_jax.cli", "run", str(experiment), *options, "--run-dir", str(run_dir)]


def below(pid: int) -> list[int]:
    """All processes below one, whichever of its threads started them (Linux)."""
    direct: list[int] = []
    for children in pathlib.Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            direct += map(int, children.read_text().split())
        except OSError:
            continue
    return direct + [deeper for child in direct for deeper in below(child)]


def running(pid: int) -> bool:
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def kill_when(moment: Callable[[pathlib.Path], bool], run_dir: pathlib.Path, arguments: list[str]) -> bool:
    """Start the command and SIGKILL it at the moment; False when it ended first. No process of it stays."""
    process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + PATIENCE
    while not moment(run_dir) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.001)
    children = below(process.pid)
    process.send_signal(signal.SIGKILL)
    killed = process.wait() == -signal.SIGKILL
    deadline = time.monotonic() + 20
    while any(map(running, children)) and time.monotonic() < deadline:
        time.sleep(0.05)
    orphans = [pid for pid in children if running(pid)]
    assert not orphans, f"processes {orphans} outlive the killed run"
    return killed


def leaves(run_dir: pathlib.Path) -> dict[str, bytes]:
    """The trained parameters, as bytes by their path."""
    experiment = load_experiment(run_dir / "experiment.toml")
    policy = make_policy(make_scene(experiment.scene), experiment.expert.limits, experiment.policy)
    tree = load_parameters(run_dir / "training", policy)
    return {
        jax.tree_util.keystr(path): np.asarray(leaf).tobytes()
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


def assert_equal_runs(one: pathlib.Path, other: pathlib.Path) -> None:
    """All results are the same, bit for bit; only what the clock says may differ."""
    first, second = (json.loads((run / "dataset/summary.json").read_text()) for run in (one, other))
    assert first["dataset_hash"] == second["dataset_hash"]
    for path in one.glob("dataset/shard-*.npz"):
        assert path.read_bytes() == (other / "dataset" / path.name).read_bytes()
    assert (one / "training/metrics.jsonl").read_bytes() == (other / "training/metrics.jsonl").read_bytes()
    assert leaves(one) == leaves(other)
    for name in ("mujoco.npz", "mujoco-traces.npz"):
        with np.load(one / "evaluation" / name) as these, np.load(other / "evaluation" / name) as those:
            assert set(these.files) == set(those.files)
            for column in these.files:
                np.testing.assert_array_equal(these[column], those[column], err_msg=column, strict=True)


@pytest.mark.slow
def test_a_run_killed_in_every_stage_ends_as_one_that_was_not(tmp_path: pathlib.Path) -> None:
    whole, killed = tmp_path / "one/whole", tmp_path / "other/killed"  # apart, so that they share nothing
    subprocess.run(command(whole, OPTIONS), check=True, capture_output=True)
    for name, moment in MOMENTS.items():
        assert kill_when(moment, killed, command(killed, OPTIONS)), f"the run ended before: {name}"
        assert not (killed / "report.html").exists()
    ended = subprocess.run(command(killed, OPTIONS), capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert (killed / "report.html").exists()
    assert_equal_runs(whole, killed)
    assert (killed / "videos/mujoco.mp4").read_bytes() == (whole / "videos/mujoco.mp4").read_bytes()
    sound = (path for path in killed.rglob("*") if not any(part.endswith(".damaged") for part in path.parts))
    assert not [path for path in sound if path.name.endswith(".tmp") or "orbax-checkpoint-tmp" in path.name]
