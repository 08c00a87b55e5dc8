"""What else can go wrong with a dataset, or be asked of it: see also test_generate.py and tests/test_cli.py."""

import ctypes
import functools
import json
import os
import pathlib
import signal
import stat
import subprocess
import sys
import tempfile

import numpy as np
import pytest
from small_dataset import DATASET, EXPERT, make

from agile_jax.dataset import load
from agile_jax.dataset.shard import make_shard
from agile_jax.engine import open_engine
from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import SceneSettings, make_scene

BASE = pathlib.Path(__file__).parents[2] / "experiments" / "base.toml"
SMALL = ["--dataset.trajectories", "4", "--dataset.shard-size", "2", "--expert.nodes", "20", "--engine", "inline"]
WALL = "[[scene.obstacles]]\nkind = 'box'\nposition = [1.5, 0.0, 0.3]\nsize = [0.1, 8.0, 0.6]"  # from bound to bound


def agile(*arguments: str, folder: pathlib.Path, text: str = "", **options: object) -> subprocess.CompletedProcess[str]:
    (folder / "e.toml").write_text(f'extends = "{BASE}"\nname = "n"\n{text}\n')
    command = [sys.executable, "-m", "agile_jax.cli", "expert", "e.toml", *SMALL, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, **options)  # type: ignore[call-overload,no-any-return]


def shard_bytes(directory: pathlib.Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(directory.glob("shard-*.npz"))}


@pytest.mark.slow
def test_four_workers_write_the_same_bytes(reference, tmp_path):
    summary = make(tmp_path, functools.partial(open_engine, "local", 4))
    assert shard_bytes(tmp_path) == shard_bytes(reference[0])
    assert summary["workers"] == 4


def give_up_permission_to_everything() -> None:
    """Root may write to read-only folders because of a capability; without it in the bounding set, a program that
    is then executed may not."""
    prctl, drop_from_bounding_set = ctypes.CDLL(None, use_errno=True).prctl, 24
    for capability in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
        if prctl(drop_from_bounding_set, capability, 0, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "prctl")


def as_anybody() -> dict[str, object]:
    """Options of a process to which permissions apply."""
    if os.geteuid() != 0:
        return {}
    try:
        subprocess.run(["true"], preexec_fn=give_up_permission_to_everything, check=True)
    except subprocess.SubprocessError:
        pytest.skip("root may write everywhere, and may not give that up here")
    return {"preexec_fn": give_up_permission_to_everything}


def test_a_read_only_folder_is_one_line_and_the_run_goes_on_later(tmp_path):
    dataset = tmp_path / "runs" / "n" / "dataset"
    assert agile(folder=tmp_path).returncode == 0
    before = shard_bytes(dataset)
    (dataset / "shard-00001.npz").unlink()
    (dataset / "summary.json").unlink()
    dataset.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        done = agile(folder=tmp_path, **as_anybody())
    finally:
        dataset.chmod(stat.S_IRWXU)
    assert done.returncode == 1
    assert "Permission denied" in done.stderr.splitlines()[-1]
    assert done.stderr.splitlines()[-1].startswith("agile: ")
    assert "Traceback" not in done.stderr
    assert list(shard_bytes(dataset)) == ["shard-00000.npz"]
    assert agile(folder=tmp_path).returncode == 0
    assert shard_bytes(dataset) == before


def mounted(folder: pathlib.Path, mount: str) -> subprocess.CompletedProcess[str]:
    """The command in a mount namespace of its own, where `mount` has been done to its folder for runs."""
    command = f"mount {mount} runs && exec {sys.executable} -m agile_jax.cli expert e.toml {' '.join(SMALL)}"
    unshare = ["unshare", "--mount", "sh", "-c", command]
    return subprocess.run(unshare, cwd=folder, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    ("mount", "words"),
    [("-t tmpfs -o size=32k none", "No space left on device"), ("-t tmpfs -o ro none", "Read-only file system")],
)
def test_a_disk_that_is_full_or_read_only_is_one_line_and_the_run_goes_on_later(tmp_path, mount, words):
    (tmp_path / "runs").mkdir()
    probe = ["unshare", "--mount", "mount", *mount.split(), str(tmp_path / "runs")]
    try:
        subprocess.run(probe, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("this user may not mount")
    (tmp_path / "e.toml").write_text(f'extends = "{BASE}"\nname = "n"\n')
    done = mounted(tmp_path, mount)
    assert done.returncode == 1, done.stderr
    assert words in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert agile(folder=tmp_path).returncode == 0


def test_a_file_where_a_folder_should_be_is_refused(tmp_path):
    (tmp_path / "runs" / "n").mkdir(parents=True)
    (tmp_path / "runs" / "n" / "dataset").write_text("not a folder")
    done = agile(folder=tmp_path)
    assert done.returncode == 2
    assert "runs/n/dataset" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "runs" / "n" / "dataset").read_text() == "not a folder"


def kill_at_first(task: object) -> object:
    """`make_shard` in a worker that is killed the first time that it gets to shard 2."""
    marker = pathlib.Path(tempfile.gettempdir()) / "killed"
    if task.indices[0] == 6 and not marker.exists():  # type: ignore[attr-defined]
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return make_shard(task)  # type: ignore[arg-type]


def test_a_worker_that_is_killed_changes_no_byte(reference, tmp_path, monkeypatch):
    (tmp_path / "scratch").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))  # of this process and its workers
    monkeypatch.setattr(tempfile, "tempdir", None)
    module = sys.modules["agile_jax.dataset.generate"]  # the package has a function of this name
    monkeypatch.setattr(module, "make_shard", kill_at_first)
    summary = make(tmp_path / "dataset", functools.partial(open_engine, "local", 1))
    assert (tmp_path / "scratch" / "killed").exists()
    assert shard_bytes(tmp_path / "dataset") == shard_bytes(reference[0])
    assert summary["dataset_hash"] == reference[1]["dataset_hash"]


def test_target_that_cannot_be_reached_is_a_failure_with_its_cause(tmp_path):
    done = agile(folder=tmp_path, text=WALL)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "dataset: none of 4 starts could be solved (no route: 4)"
    summary = json.loads((tmp_path / "runs/n/dataset/summary.json").read_text())
    assert (summary["attempted"], summary["trajectories"], summary["unverified"]) == (4, 0, 0)


def test_one_node_is_refused_before_any_work(tmp_path):
    done = agile("--expert.nodes", "1", folder=tmp_path)
    assert done.returncode == 2
    assert "expert.nodes = 1" in done.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("nodes", [10, 20, pytest.param(1000, marks=pytest.mark.slow)])
def test_few_and_many_nodes_give_labels_or_causes(tmp_path, nodes):
    expert = EXPERT.model_copy(update={"nodes": nodes})
    summary = make(tmp_path, expert=expert, dataset=DATASET.model_copy(update={"trajectories": 4}))
    assert summary["attempted"] == 4 == summary["trajectories"] + sum(summary["failed"].values())
    assert summary["unverified"] == 0
    assert summary["trajectories"] > 0
    assert summary["max_clearance_violation_m"] == 0
    assert load(tmp_path).states.shape == (summary["trajectories"], nodes + 1, 8)


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_start_at_the_target_is_a_label_that_stays_there(condition):
    scene = make_scene(SceneSettings())
    solution = make_expert(scene, ExpertSettings(nodes=40)).solve(scene.target, condition)
    assert solution.status == "solved", solution.cause
    assert 0 <= solution.duration < 0.01
    assert np.abs(solution.trajectory.states[:, :4] - scene.target).max() < 1e-3
    assert np.isfinite(solution.trajectory.controls).all()
