"""Reading a dataset: splits, samples, and what is refused."""

import json

import numpy as np
import pytest
from small_dataset import SEED

from agile_jax.dataset import DatasetSettings, load, samples, split_mask
from agile_jax.settings import BadInput


def test_split_is_by_trajectory_balanced_and_fixed(reference):
    dataset = load(reference[0])
    settings = DatasetSettings()
    masks = [split_mask(dataset, split, settings) for split in ("train", "validation", "test")]
    np.testing.assert_array_equal(np.sum(masks, axis=0), 1)
    many = dataset._replace(indices=np.arange(1000))
    for split, fraction in zip(("train", "validation", "test"), settings.split, strict=True):
        mask = split_mask(many, split, settings)
        assert mask.mean() == pytest.approx(fraction, abs=0.005)
        np.testing.assert_array_equal(mask[dataset.indices], split_mask(dataset, split, settings))
    other = split_mask(many._replace(seed=SEED + 1), "train", settings)
    assert (other != split_mask(many, "train", settings)).any()


def test_samples(reference):
    dataset = load(reference[0])
    poses, velocities = samples(dataset, "train", DatasetSettings())
    train = split_mask(dataset, "train", DatasetSettings())
    assert poses.shape == velocities.shape == (train.sum() * 41, 4)
    np.testing.assert_array_equal(poses[:41], dataset.states[train][0, :, :4])
    np.testing.assert_array_equal(velocities[:41], dataset.states[train][0, :, 4:])
    later, _ = samples(dataset, "train", DatasetSettings(samples="without_start", start_seconds=0.6))
    assert len(later) == (dataset.times[train] >= 0.6).sum() < len(poses)


def test_bad_datasets_and_settings_are_refused(tmp_path, copy):
    with pytest.raises(BadInput, match=r"manifest\.json is missing"):
        load(tmp_path / "nothing")
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["schema_version"] = 99
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BadInput, match="schema_version 99"):
        load(copy)
    with pytest.raises(ValueError, match="must add up to 1"):
        DatasetSettings(split=(0.8, 0.1, 0.2))
