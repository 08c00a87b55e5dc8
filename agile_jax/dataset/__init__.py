"""The dataset: verified trajectories of the expert in immutable, checked shards, split by trajectory. Loads no JAX."""

from agile_jax.dataset.dataset import SPLITS, Dataset, Split, labels_to, load, samples, split_mask
from agile_jax.dataset.generate import IncompleteDatasetError, generate
from agile_jax.dataset.settings import DatasetSettings

__all__ = [
    "SPLITS",
    "Dataset",
    "DatasetSettings",
    "IncompleteDatasetError",
    "Split",
    "generate",
    "labels_to",
    "load",
    "samples",
    "split_mask",
]
