import json

import jax
import numpy as np
import pytest
from synthetic import ACCELERATION, LIMITS, SMALL, TARGET, VELOCITY, empty_scene

from agile_jax.dataset import Dataset, DatasetSettings, samples
from agile_jax.experiment import Experiment
from agile_jax.expert import ExpertSettings
from agile_jax.policy import make_policy, parameter_count
from agile_jax.scene import SceneSettings, StartSettings
from agile_jax.settings import BadInput
from agile_jax.sweep.numbers import NUMBERS
from agile_jax.training import KinematicTestSettings, TrainingSettings, fit_dataset, train_on
from agile_jax.training.checkpoint import load_parameters

REQUIRED = {"train_mse", "validation_mse", "test_mse", "noise_floor_mse"}
REQUIRED |= {"seconds", "compile_seconds", "epochs", "parameters", "device"}
EXPERT = ExpertSettings(velocity=tuple(VELOCITY), acceleration=tuple(ACCELERATION))
SETTINGS = TrainingSettings(batch_size=64, epochs=3)
LOOPS = KinematicTestSettings(starts=16)
SCENE = SceneSettings(
    start=StartSettings(mean=(2.4, 0.0, 0.27, 0.0), std=(0.2, 0.2, 0.01, 0.0))
)  # where the labels are


def run(labels, directory, seed=0, expert=EXPERT, policy=SMALL, training=SETTINGS, kinematic_test=LOOPS, **sections):
    """The stage with these sections."""
    sections |= {"expert": expert, "policy": policy, "training": training, "kinematic_test": kinematic_test}
    return train_on(labels, Experiment(name="test", seed=seed, scene=SCENE, **sections), directory)


def straight_lines(count: int = 40, nodes: int = 30) -> Dataset:
    """Rest to rest along straight lines without a bound on the velocity: a position is passed at different speeds."""
    generator = np.random.default_rng(0)
    starts = TARGET + generator.uniform(-1, 1, (count, 4)) * [1.0, 0.5, 0.03, 0.3]
    error = starts - TARGET
    durations = 2 * np.sqrt((np.abs(error) / ACCELERATION).max(-1))
    phase = np.linspace(0, 1, nodes + 1)[:, None]  # of the time
    path = np.where(phase < 0.5, 2 * phase**2, 1 - 2 * (1 - phase) ** 2)
    rate = 4 * np.minimum(phase, 1 - phase) / durations[:, None, None]
    acceleration = np.where(phase[:-1] < 0.5, -4, 4) / durations[:, None, None] ** 2
    states = np.concatenate([starts[:, None] - path * error[:, None], -rate * error[:, None]], -1)
    return Dataset(
        indices=np.arange(count),
        times=phase[:, 0] * durations[:, None],
        states=states,
        controls=acceleration * error[:, None],
        starts=starts,
        targets=np.tile(TARGET, (count, 1)),
        durations=durations,
        lower_bounds=durations,
        branches=np.full(count, "direct"),
        seed=0,
        dataset_hash="straight lines",
    )


def test_training_stage_writes_the_contracts_summary(tmp_path):
    dataset, scene = straight_lines(), empty_scene()
    summary = run(dataset, tmp_path)
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    assert summary.keys() >= REQUIRED
    assert {key for key, value in summary.items() if isinstance(value, int | float)} <= set(NUMBERS["training"])
    assert summary["epochs"] == 3

    policy = make_policy(scene, LIMITS, SMALL)
    parameters = load_parameters(tmp_path, policy)
    assert summary["parameters"] == parameter_count(parameters) == 4 * 16 + 16 + 16 * 16 + 16 + 16 * 4 + 4
    for split in ("train", "validation", "test"):
        poses, labels = samples(dataset, split, DatasetSettings())
        predicted = jax.vmap(lambda pose: policy.output(parameters, policy.encode(pose)))(poses)
        assert summary[f"{split}_mse"] == pytest.approx(np.mean((np.asarray(predicted) - labels) ** 2), rel=1e-4)
    assert 0 < summary["noise_floor_mse"] < summary["label_variance"]
    assert summary["field_arrived_rate"] == 1.0  # without obstacles the braking law brings every start home
    assert summary["field_min_clearance_m_p05"] is None
    assert summary["field_final_error_m_max"] < 0.01
    with np.load(tmp_path / "kinematic_test.npz") as rows:
        ratio = (rows["arrival_time"] / rows["expert_time"])[rows["expert_time"] > 1.0]
    assert summary["field_time_ratio_median"] == pytest.approx(np.quantile(ratio, 0.5, method="lower"))
    assert 0.9 < summary["field_time_ratio_median"] < 1.6


def test_training_stage_on_the_samples_without_their_start(tmp_path):
    dataset = straight_lines()
    without = DatasetSettings(samples="without_start", start_seconds=0.2)
    summary = run(dataset, tmp_path, dataset=without)
    assert summary["training_samples"] == len(samples(dataset, "train", without)[0])
    with pytest.raises(BadInput, match=r"dataset\.samples: 'without_start' there, 'all' asked for"):
        run(dataset, tmp_path)


def leaves(directory):
    return jax.tree.leaves(load_parameters(directory, make_policy(empty_scene(), LIMITS, SMALL)))


def test_more_epochs_go_on_where_the_schedule_allows_and_are_refused_where_it_depends_on_their_number(tmp_path):
    dataset = straight_lines()
    constant = SETTINGS.model_copy(update={"schedule": "constant", "checkpoint_every": 1})
    run(dataset, tmp_path / "more", training=constant)
    begun = (tmp_path / "more" / "checkpoints" / "3").stat().st_mtime_ns
    run(dataset, tmp_path / "more", training=constant.model_copy(update={"epochs": 4}))
    assert (tmp_path / "more" / "checkpoints" / "3").stat().st_mtime_ns == begun  # it is taken up
    run(dataset, tmp_path / "whole", training=constant.model_copy(update={"epochs": 4}))
    for a, b in zip(leaves(tmp_path / "more"), leaves(tmp_path / "whole"), strict=True):
        assert np.array_equal(a, b)
    assert (tmp_path / "more/metrics.jsonl").read_bytes() == (tmp_path / "whole/metrics.jsonl").read_bytes()
    run(dataset, tmp_path / "cosine")
    with pytest.raises(BadInput, match=r"training\.epochs: 3 there, 4 asked for.*Use another run directory"):
        run(dataset, tmp_path / "cosine", training=SETTINGS.model_copy(update={"epochs": 4}))


def test_in_memory_the_stage_fits_the_same_policy(tmp_path):
    dataset = straight_lines()
    run(dataset, tmp_path)
    settings = {"scene": SCENE, "expert": EXPERT, "policy": SMALL, "training": SETTINGS, "kinematic_test": LOOPS}
    fitted = fit_dataset(dataset, Experiment(name="test", **settings))
    for a, b in zip(leaves(tmp_path), jax.tree.leaves(fitted.parameters), strict=True):
        assert np.array_equal(a, b)
    assert fitted.rows == [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert fitted.policy(TARGET) == pytest.approx(np.zeros(4), abs=1e-5)
