"""Datasets are the same bytes however they come about, and are repaired by the same call."""

import functools
import io
import json
import logging
import os
import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from small_dataset import DATASET, EXPERT, INLINE, SCENE, SEED, make

from agile_jax.dataset import DatasetSettings, load, make_labels
from agile_jax.dataset.shard import LabelSettings, ShardTask, make_shard
from agile_jax.engine import TasksFailedError, open_engine
from agile_jax.expert import ExpertSettings, verify
from agile_jax.files import sha256
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.settings import BadInput
from agile_jax.store.npz import npz_bytes


def closed_engine():
    raise AssertionError("nothing is missing, so no engine is needed")


def shard_bytes(directory):
    return {path.name: path.read_bytes() for path in sorted(directory.glob("shard-*.npz"))}


def test_summary_keeps_the_contract(reference):
    directory, summary = reference
    assert json.loads((directory / "summary.json").read_text()) == summary
    assert summary["attempted"] == 10
    assert summary["trajectories"] + sum(summary["failed"].values()) == 10
    assert sum(summary["branches"].values()) == summary["trajectories"]
    assert sum(summary["methods"].values()) == summary["trajectories"]
    assert set(summary["rescued"]) <= set(summary["methods"]) - {"certified", "fatrop"}
    assert summary["drawn_starts"] == 10 + summary["rejected_starts"]
    assert summary["unverified"] == 0
    assert summary["max_clearance_violation_m"] <= 0
    assert summary["max_dynamics_residual"] < 1e-6
    assert summary["workers"] == 1
    assert summary["labels_per_second"] > 0
    assert summary["solve_time_ms_median"] > 0
    manifest = json.loads((directory / "manifest.json").read_text())
    assert {e["file"]: e["sha256"] for e in manifest["shards"]} == {
        name: sha256(data) for name, data in shard_bytes(directory).items()
    }


def test_loaded_trajectories_pass_the_independent_check(reference):
    dataset = load(reference[0])
    scene = make_scene(SCENE)
    assert len(dataset.indices) == reference[1]["trajectories"]
    assert dataset.dataset_hash == reference[1]["dataset_hash"]
    from agile_jax.expert import Trajectory, rejection

    for k in range(len(dataset.indices)):
        trajectory = Trajectory(dataset.times[k], dataset.states[k], dataset.controls[k])
        assert rejection(verify(scene, EXPERT, trajectory, dataset.starts[k])) is None
        assert dataset.durations[k] == dataset.times[k, -1] >= dataset.lower_bounds[k] - 1e-6


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_bytes_do_not_depend_on_the_engine(reference, tmp_path, workers):
    summary = make(tmp_path, functools.partial(open_engine, "local", workers))
    assert shard_bytes(tmp_path) == shard_bytes(reference[0])
    assert summary["dataset_hash"] == reference[1]["dataset_hash"]
    assert summary["workers"] == workers


def test_bytes_do_not_depend_on_time_or_order(reference):
    time.sleep(2.1)  # zip files keep dates to two seconds
    settings = LabelSettings(SCENE, EXPERT, DATASET, SEED)
    for shard in (2, 0):
        members = range(3 * shard, 3 * shard + 3)
        rows = make_shard(ShardTask(settings, tuple(members))).arrays
        key = np.array(json.loads((reference[0] / "manifest.json").read_text())["key"])
        data = npz_bytes({"key": key, "index": np.array(members), **rows})
        assert data == shard_bytes(reference[0])[f"shard-{shard:05d}.npz"]


def test_second_call_computes_nothing(copy, reference):
    before = {path: path.stat().st_mtime_ns for path in copy.iterdir()}
    assert make(copy, closed_engine) == reference[1]
    assert {path: path.stat().st_mtime_ns for path in copy.iterdir()} == before


def test_summary_and_manifest_are_rebuilt_from_the_shards(copy, reference):
    (copy / "summary.json").unlink()
    (copy / "manifest.json").write_text("{half a fi")
    assert make(copy, closed_engine) == reference[1]
    assert shard_bytes(copy) == shard_bytes(reference[0])
    assert load(copy).dataset_hash == reference[1]["dataset_hash"]


DRIVER = """
import functools, pathlib, sys, time
from agile_jax.dataset import DatasetSettings, make_labels
from agile_jax.dataset.shard import LabelSettings
from agile_jax.engine import open_engine
from agile_jax.expert import ExpertSettings
from agile_jax.scene import SceneSettings

def slowly(work, done, total, note=""):
    print(done, flush=True)
    time.sleep(0.3)

if __name__ == "__main__":
    scene = SceneSettings.model_validate_json(sys.argv[1])
    expert = ExpertSettings.model_validate_json(sys.argv[2])
    dataset = DatasetSettings.model_validate_json(sys.argv[3])
    engine = functools.partial(open_engine, "local", 2)
    settings = LabelSettings(scene, expert, dataset, int(sys.argv[4]))
    make_labels(settings, pathlib.Path(sys.argv[5]), engine, slowly)
"""


def test_killed_in_the_middle_then_resumed(reference, tmp_path):
    script, directory = tmp_path / "driver.py", tmp_path / "dataset"
    script.write_text(DRIVER)
    settings = [part.model_dump_json() for part in (SCENE, EXPERT, DATASET)]
    arguments = [*settings, str(SEED), str(directory)]
    process = subprocess.Popen([sys.executable, str(script), *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "0\n"
    assert int(process.stdout.readline()) > 0
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert 0 < len(shard_bytes(directory)) < 4
    assert not (directory / "manifest.json").exists()
    (directory / ".shard-00003.npz.0.tmp").write_bytes(b"half a write")

    kept = {path: path.stat().st_mtime_ns for path in directory.glob("shard-*.npz")}
    summary = make(directory)
    assert summary["dataset_hash"] == reference[1]["dataset_hash"]
    assert shard_bytes(directory) == shard_bytes(reference[0])
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert not list(directory.glob(".*.tmp"))


def flip_bit(data):
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 4]) + data[middle + 1 :]


def pickled(_):
    buffer = io.BytesIO()
    np.savez(buffer, key=np.array([{"an": "object"}], dtype=object))
    return buffer.getvalue()


def bomb(_):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr("../../key.npy", b"x")
    return buffer.getvalue()


@pytest.mark.parametrize("with_manifest", [True, False])
@pytest.mark.parametrize(
    "damage",
    [flip_bit, lambda data: data[: len(data) // 2], lambda data: b"", pickled, bomb, lambda data: data + b"\0"],
)
def test_damaged_shard_is_quarantined_and_made_again(copy, reference, damage, with_manifest, caplog):
    path = copy / "shard-00001.npz"
    damaged = damage(path.read_bytes())
    path.write_bytes(damaged)
    with pytest.raises(BadInput, match=r"shard-00001\.npz"):
        load(copy)
    if not with_manifest:
        (copy / "manifest.json").unlink()
        if damaged[:-1] == reference[0].joinpath(path.name).read_bytes():
            pytest.skip("a byte after the archive's end changes nothing in it; only the manifest can tell")
    with caplog.at_level(logging.WARNING):
        summary = make(copy)
    assert summary["dataset_hash"] == reference[1]["dataset_hash"]
    assert shard_bytes(copy) == shard_bytes(reference[0])
    assert [p.read_bytes() for p in (copy / "quarantine").iterdir()] == [damaged]
    assert len([r for r in caplog.records if "quarantine" in r.getMessage()]) == 1


def test_shards_of_other_settings_or_places_are_not_used(copy, reference, caplog):
    os.replace(copy / "shard-00000.npz", copy / "shard-00001.npz")
    (copy / "shard-00077.npz").write_bytes(b"of an older, longer dataset")
    (copy / "notes.txt").write_text("somebody's")
    with caplog.at_level(logging.WARNING):
        assert make(copy)["dataset_hash"] == reference[1]["dataset_hash"]
    assert len(list((copy / "quarantine").iterdir())) == 2
    assert (copy / "notes.txt").exists()
    assert any("notes.txt" in r.getMessage() for r in caplog.records)
    other = make_labels(LabelSettings(SCENE, EXPERT, DATASET, SEED + 1), copy, INLINE)
    assert other["dataset_hash"] != reference[1]["dataset_hash"]
    assert len(list((copy / "quarantine").iterdir())) == 6


def test_dataset_grows_by_what_is_missing(copy, reference):
    before = shard_bytes(copy)
    made = []

    class Counting:
        workers = 1

        def map(self, function, tasks, time_limit_s=None):
            for i, task in enumerate(tasks):
                made.append(task.indices)
                yield i, function(task)

    import contextlib

    longer = DATASET.model_copy(update={"trajectories": 14})
    summary = make(copy, lambda: contextlib.nullcontext(Counting()), dataset=longer)
    assert made == [(10, 11), (12, 13)]  # the last shard was not full
    assert summary["attempted"] == 14
    assert {name: shard_bytes(copy)[name] for name in sorted(before)[:3]} == {
        name: before[name] for name in sorted(before)[:3]
    }


def test_failed_tasks_are_named_and_the_others_kept(tmp_path):
    class Failing:
        workers = 1

        def map(self, function, tasks, time_limit_s=None):
            from agile_jax.engine import TaskFailure

            for i, task in enumerate(tasks):
                yield i, (TaskFailure(i, "KilledWorker: too bad") if task.indices[0] == 3 else function(task))

    import contextlib

    with pytest.raises(TasksFailedError, match=r"shard-00001\.npz: KilledWorker"):
        make(tmp_path, lambda: contextlib.nullcontext(Failing()))
    assert sorted(shard_bytes(tmp_path)) == ["shard-00000.npz", "shard-00002.npz", "shard-00003.npz"]
    assert not (tmp_path / "manifest.json").exists()


def test_failures_are_kept_with_their_cause(tmp_path):
    """A wall that nothing passes; some starts are beyond it."""
    start = {"mean": [1.5, 0.0, 0.28, 0.0], "std": [1.0, 0.3, 0.01, 0.2]}
    wall = {"kind": "box", "position": [1.5, 0.0, 0.5], "size": [0.1, 8.0, 1.0]}
    scene = SceneSettings(obstacles=[wall], start=start)
    dataset = DatasetSettings(trajectories=6, shard_size=6)
    summary = make_labels(LabelSettings(scene, ExpertSettings(nodes=20), dataset, 0), tmp_path, INLINE)
    assert summary["attempted"] == 6
    assert summary["failed"].get("no route", 0) + summary["trajectories"] == 6
    assert 0 < summary["trajectories"] < 6
    with np.load(tmp_path / "shard-00000.npz", allow_pickle=False) as file:
        failed = ~file["solved"]
        assert failed.sum() == summary["failed"]["no route"]
        assert not file["states"][failed].any()
        assert all(cause.startswith("no route") for cause in file["cause"][failed])
    assert len(load(tmp_path).indices) == summary["trajectories"]
