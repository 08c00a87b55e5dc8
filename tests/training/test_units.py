"""The readings of a mean squared error: which labels, in which unit, split how."""

import jax
import numpy as np
import pytest
from synthetic import LIMITS, TARGET, VELOCITY, empty_scene
from test_stage import run, straight_lines

from agile_jax.dataset import DatasetSettings, labels, samples, split_mask
from agile_jax.policy import PolicySettings, make_policy
from agile_jax.training import TrainingSettings
from agile_jax.training.checkpoint import load_parameters
from agile_jax.training.samples import make_units

PLAIN = PolicySettings(kind="plain", hidden_layers=(16, 16))
SETTINGS = TrainingSettings(batch_size=64, epochs=3)
DISPLACEMENT = DatasetSettings(label_kind="displacement")


@pytest.fixture(scope="module")
def dataset():
    return straight_lines()


def test_displacements_add_up_to_the_path(dataset):
    found = labels(dataset, DISPLACEMENT)
    np.testing.assert_allclose(dataset.starts + found.sum(1), np.broadcast_to(TARGET, (40, 4)), atol=1e-12)
    assert (found[:, -1] == 0).all()
    np.testing.assert_array_equal(labels(dataset, DatasetSettings()), dataset.states[..., 4:])


def test_split_by_sample_deals_out_every_sample_once_in_the_fractions(dataset):
    settings = DatasetSettings(split_by="sample")
    parts = [samples(dataset, split, settings)[0] for split in ("train", "validation", "test")]
    assert [len(part) for part in parts] == [992, 124, 124]
    together, all_poses = np.concatenate(parts), dataset.states[..., :4].reshape(-1, 4)
    assert np.array_equal(together[np.lexsort(together.T)], all_poses[np.lexsort(all_poses.T)])
    # Nearly every trajectory is on both sides: the leak that this reading has.
    seen = {tuple(pose) for pose in parts[0]}
    shared = [any(tuple(pose) in seen for pose in path[:-1, :4]) for path in dataset.states]
    assert np.mean(shared) > 0.9
    by_trajectory = [set(map(tuple, samples(dataset, split, DatasetSettings())[0])) for split in ("train", "test")]
    assert by_trajectory[0] & by_trajectory[1] == {tuple(TARGET)}


def test_units(dataset):
    chosen = split_mask(dataset, "train", DatasetSettings())
    h = np.diff(dataset.times[chosen]).mean()

    def unit(units, settings):
        return make_units(dataset, settings, TrainingSettings(output_units=units), VELOCITY)

    np.testing.assert_allclose(unit("si", DatasetSettings()).output, 1)
    np.testing.assert_allclose(unit("limits", DatasetSettings()).output, VELOCITY)
    velocities = dataset.states[chosen][..., 4:].reshape(-1, 4)
    np.testing.assert_allclose(unit("std", DatasetSettings()).output, velocities.std(0))
    assert unit("si", DISPLACEMENT).interval == pytest.approx(h)
    np.testing.assert_allclose(unit("si", DISPLACEMENT).output, 1 / h)
    steps = labels(dataset, DISPLACEMENT)[chosen].reshape(-1, 4)
    np.testing.assert_allclose(unit("std", DISPLACEMENT).output, steps.std(0) / h)
    still = dataset._replace(states=dataset.states * [1, 1, 1, 1, 1, 1, 1, 0])
    settings = TrainingSettings(output_units="std")
    found = make_units(still, DatasetSettings(), settings, VELOCITY).output
    assert found[3] == VELOCITY[3]


@pytest.mark.parametrize(("target", "units"), [("velocity", "std"), ("displacement", "si"), ("displacement", "std")])
def test_errors_are_those_of_the_network_in_its_own_units(target, units, dataset, tmp_path):
    reading = DatasetSettings(label_kind=target)
    training = SETTINGS.model_copy(update={"output_units": units})
    summary = run(dataset, tmp_path, policy=PLAIN, training=training, dataset=reading)
    policy = make_policy(empty_scene(), LIMITS, PLAIN)
    parameters = load_parameters(tmp_path, policy)

    def outputs(split):
        poses, wanted = samples(dataset, split, reading)
        velocities = jax.vmap(lambda pose: policy.output(parameters, policy.encode(pose)))(poses)
        return np.asarray(velocities) / np.asarray(parameters.normalization.scale), wanted

    found, wanted = outputs("test")
    own = wanted  # with target = displacement and si, the outputs are displacements
    if units == "std":
        chosen = split_mask(dataset, "train", reading)
        own = wanted / labels(dataset, reading)[chosen].reshape(-1, 4).std(0)
    assert summary["test_mse_own_units"] == pytest.approx(np.mean((found - own) ** 2), rel=1e-3)
    poses, velocities = samples(dataset, "test", DatasetSettings())
    predicted = jax.vmap(lambda pose: policy.output(parameters, policy.encode(pose)))(poses)
    assert summary["test_mse"] == pytest.approx(np.mean((np.asarray(predicted) - velocities) ** 2), rel=1e-3)
    assert summary["noise_floor_mse_own_units"] > 0
    if units == "si":  # in metres a node, far smaller numbers
        assert summary["test_mse_own_units"] < 0.1 * summary["test_mse"]


def test_units_of_a_structured_policy_are_refused(dataset, tmp_path):
    residual = PolicySettings(hidden_layers=(16,))
    with pytest.raises(ValueError, match=r'output_units = "std" is for policy\.kind = "plain"'):
        run(dataset, tmp_path, policy=residual, training=TrainingSettings(output_units="std"))
    with pytest.raises(ValueError, match=r'dataset\.label_kind = "displacement" is for policy\.kind = "plain"'):
        run(dataset, tmp_path, policy=residual, training=SETTINGS, dataset=DISPLACEMENT)


def test_several_seeds_in_the_summary(dataset, tmp_path):
    summary = run(dataset, tmp_path, 5, policy=PLAIN, training=SETTINGS.model_copy(update={"seeds": 2}))
    assert summary["chosen_seed"] in (5, 6)
    assert summary["test_mse_seeds_min"] <= summary["test_mse"] <= summary["test_mse_seeds_max"]
    assert summary["test_mse_seeds_min"] < summary["test_mse_seeds_max"]
