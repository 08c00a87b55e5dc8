"""Rounds of aggregation: what is asked, that the answers are learned, and that a kill changes nothing."""

import json
import shutil

import jax
import numpy as np
import pytest
from synthetic import LIMITS, SMALL, table_scene
from test_stage import EXPERT, SCENE, run as run_stage, straight_lines

from agile_jax.dataset import DatasetSettings, samples
from agile_jax.policy import make_policy
from agile_jax.scene import clearance, make_scene
from agile_jax.training import AggregationSettings, KinematicTestSettings, TrainingSettings
from agile_jax.training.aggregation import BEFORE, visited_poses
from agile_jax.training.checkpoint import load_parameters

AGGREGATION = AggregationSettings(rounds=1, starts=6, queries=10, epochs=2, rate=0.5)
KINEMATIC_TEST = KinematicTestSettings(starts=4, every=2, watched_starts=4)
BRIEF = TrainingSettings(batch_size=64, epochs=2, checkpoint_every=1)


def run(directory):
    expert = EXPERT.model_copy(update={"nodes": 20, "initial_velocity": "free"})
    rest = {"kinematic_test": KINEMATIC_TEST, "aggregation": AGGREGATION}
    return run_stage(straight_lines(), directory, expert=expert, training=BRIEF, **rest)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("aggregation")
    return directory, run(directory)


def ending(directory):
    parameters = load_parameters(directory, make_policy(make_scene(SCENE), LIMITS, SMALL))
    return [np.asarray(leaf) for leaf in jax.tree.leaves(parameters)]


def test_a_round_adds_the_experts_answers_and_goes_on_from_its_parameters(finished):
    directory, summary = finished
    assert summary["aggregation_asked"] == summary["aggregation_answered"] == 6  # without obstacles one pose a rollout
    alone = len(samples(straight_lines(), "train", DatasetSettings())[0])
    assert summary["epochs"] == 4
    assert summary["training_samples"] == alone + 6 * 21
    rows = [json.loads(line) for line in (directory / "metrics.jsonl").read_text().splitlines()]
    assert [("field_arrived_rate" in row) for row in rows] == [False, True]
    assert rows[0]["learning_rate"] <= 0.5 * BRIEF.learning_rate
    first = json.loads((directory / "round-0" / "metrics.jsonl").read_text().splitlines()[-1])
    assert rows[0]["train_mse"] < 2 * first["train_mse"]  # it did not begin anew
    assert not all(np.array_equal(a, b) for a, b in zip(ending(directory), ending(directory / "round-0"), strict=True))


@pytest.mark.parametrize("lost", ["last epoch", "first round"])
def test_a_kill_changes_nothing(finished, tmp_path, lost):
    source, summary = finished
    directory = shutil.copytree(source, tmp_path / "copy")
    (directory / "summary.json").unlink()
    (directory / "kinematic_test.npz").unlink()
    shutil.rmtree(directory / "checkpoints" / "2")
    if lost == "first round":
        shutil.rmtree(directory / "checkpoints")
        (directory / "metrics.jsonl").unlink()
        (directory / "round-0" / "queries" / "part-00000.npz").unlink()
        shutil.rmtree(directory / "round-0" / "checkpoints" / "2")
    again = run(directory)
    clock = {"seconds", "compile_seconds"}
    assert {k: v for k, v in again.items() if k not in clock} == {k: v for k, v in summary.items() if k not in clock}
    assert all(np.array_equal(a, b) for a, b in zip(ending(directory), ending(source), strict=True))
    for name in ("metrics.jsonl", "kinematic_test.npz", "round-0/metrics.jsonl", "round-0/queries/part-00000.npz"):
        assert (directory / name).read_bytes() == (source / name).read_bytes()


def test_poses_are_asked_about_on_the_way_to_the_nearest_and_behind_it():
    scene, dt = table_scene(), 0.02
    x = np.arange(0.0, 2.5, 0.01)  # 0.5 m/s, and it brushes the table's edge in the middle
    height = np.where(np.abs(x - 1.5) < 0.6, 0.25 - scene.torso_half_size[2] - 0.01, 0.17)
    path = np.stack([x, 0 * x, height, 0 * x], -1)
    margin = 0.03
    poses = visited_poses(scene, path, margin, dt)
    distances = clearance(scene, poses)
    assert (distances >= margin).all()
    nearest = int(np.argmin(clearance(scene, path)))
    last = int(np.flatnonzero(clearance(scene, path)[:nearest] >= margin)[-1])
    expected = [last - round(seconds / dt) for seconds in BEFORE]
    np.testing.assert_array_equal(poses[:-1], path[expected])
    assert poses[-1, 0] > path[nearest, 0]
