"""Labels to several targets."""

import functools
import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest
from small_dataset import DATASET, EXPERT, SCENE, make

from agile_jax.dataset import labels_to, load
from agile_jax.engine import open_engine
from agile_jax.expert import Trajectory, lower_bound, rejection, verify
from agile_jax.scene import facing, make_scene
from agile_jax.settings import BadInput

TARGETS = ((3.0, 0.0, 0.28, 0.0), (2.5, -1.2, 0.3, 3.0), (-0.5, 1.0, 0.2, -3.1))
SEVERAL = DATASET.model_copy(update={"targets": TARGETS})
BASE = pathlib.Path(__file__).parents[2] / "experiments" / "base.toml"


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    directory = tmp_path_factory.mktemp("targets")
    make(directory, dataset=SEVERAL)
    return directory


def test_targets_take_turns_and_every_label_is_verified_against_its_own(directory):
    dataset, scene = load(directory), make_scene(SCENE)
    np.testing.assert_array_equal(dataset.targets, np.array(TARGETS)[dataset.indices % 3])
    assert len(dataset.indices) == 10
    for k, target in enumerate(dataset.targets):
        world = scene._replace(target=target)
        trajectory = Trajectory(dataset.times[k], dataset.states[k], dataset.controls[k])
        assert rejection(verify(world, EXPERT, trajectory, dataset.starts[k])) is None
        assert (
            rejection(verify(scene._replace(target=target + 0.01), EXPERT, trajectory, dataset.starts[k])) is not None
        )
        seen = facing(world, dataset.starts[k]).target
        assert dataset.lower_bounds[k] == lower_bound(dataset.starts[k], seen, EXPERT, "rest")


def test_the_scenes_target_is_the_default_and_its_labels_are_the_same(directory, reference):
    """The first of three targets is the scene's: every third label is that of the dataset without targets."""
    one, several = load(reference[0]), load(directory)
    np.testing.assert_array_equal(one.targets, np.tile(SCENE.target, (len(one.targets), 1)))
    third = labels_to(several, np.array(SCENE.target))
    assert third.indices.tolist() == [i for i in several.indices.tolist() if i % 3 == 0]
    same = np.isin(one.indices, third.indices)
    np.testing.assert_array_equal(one.states[same], third.states)
    assert third.seed == several.seed


def test_no_label_to_a_target_is_refused(directory):
    with pytest.raises(BadInput, match=r"no label leads to scene.target = \[0.0, 0.0, 0.28, 0.0\].*dataset.targets"):
        labels_to(load(directory), np.array([0.0, 0.0, 0.28, 0.0]))


@pytest.mark.parametrize("bad", [(1.5, 0.0, 0.28, 0.0), (9.0, 0.0, 0.28, 0.0), (0.0, 0.0, 0.9, 0.0)])
def test_bad_targets_are_refused_by_number_before_any_work(tmp_path, bad):
    dataset = DATASET.model_copy(update={"targets": (TARGETS[0], bad)})
    with pytest.raises(BadInput, match=r"^dataset.targets\[1\]"):
        make(tmp_path / "d", dataset=dataset)
    assert not (tmp_path / "d").exists()
    line = f"targets = [[3.0, 0.0, 0.28, 0.0], {list(bad)}]"
    (tmp_path / "e.toml").write_text(f'extends = "{BASE}"\nname = "n"\n[dataset]\n{line}\n')
    command = [sys.executable, "-m", "agile_jax.cli", "expert", "e.toml", "--engine", "inline"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert re.search(r"e\.toml: dataset\.targets(\[1\]|\.1\.\d) ", done.stderr)  # the whole pose, or an axis of it
    assert not (tmp_path / "runs").exists()


def test_shards_of_the_schema_before_are_made_again(copy, reference, caplog):
    """A shard without targets is quarantined with its cause."""
    path = copy / "shard-00002.npz"
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if name != "target"}
    np.savez(path, **arrays)
    (copy / "manifest.json").unlink()
    assert make(copy)["dataset_hash"] == reference[1]["dataset_hash"]
    assert any("array target is missing" in record.getMessage() for record in caplog.records)


@pytest.mark.slow
def test_two_workers_write_the_same_bytes(directory, tmp_path):
    make(tmp_path, functools.partial(open_engine, "local", 2), dataset=SEVERAL)
    for path in directory.glob("shard-*.npz"):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()
