"""The dataset: verified trajectories of the expert in immutable, checked shards, split by trajectory. Loads no JAX."""

from agile_jax.dataset.dataset import SPLITS, Dataset, Split, labels, labels_to, load, samples, split_mask
from agile_jax.dataset.expert_time import ExpertTimes, expert_times, time_limit
from agile_jax.dataset.generate import IncompleteDatasetError, generate
from agile_jax.dataset.queries import Answers, ask
from agile_jax.dataset.settings import DatasetSettings
from agile_jax.dataset.starts import unseen_starts
from agile_jax.dataset.write import write

__all__ = [
    "SPLITS",
    "Answers",
    "Dataset",
    "DatasetSettings",
    "ExpertTimes",
    "IncompleteDatasetError",
    "Split",
    "ask",
    "expert_times",
    "generate",
    "labels",
    "labels_to",
    "load",
    "samples",
    "split_mask",
    "time_limit",
    "unseen_starts",
    "write",
]
