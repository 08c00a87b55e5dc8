"""What else can go wrong with a dataset, or be asked of it: see also test_generate.py and tests/test_cli.py."""

import ctypes
import functools
import json
import os
import pathlib
import stat
import subprocess
import sys

import numpy as np
import pytest
from small_dataset import EXPERT, INLINE, SCENE, SEED, make

from agile_jax.dataset import DatasetSettings, generate, load
from agile_jax.engine import open_engine
from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import SceneSettings, make_scene

BASE = pathlib.Path(__file__).parents[2] / "experiments" / "base.toml"
SMALL = ["--expert.trajectories", "4", "--expert.shard-size", "2", "--expert.nodes", "20", "--engine", "inline"]
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
    expert = EXPERT.model_copy(update={"nodes": nodes, "trajectories": 4})
    summary = generate(SCENE, expert, DatasetSettings(), SEED, tmp_path, INLINE)
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
