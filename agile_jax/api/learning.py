"""Labels and training in memory: for a notebook, or to try something once. Nothing is kept."""

import pathlib
import tempfile
from functools import partial
from typing import TYPE_CHECKING

from agile_jax import training
from agile_jax.dataset import Dataset, generate, load
from agile_jax.engine import open_engine
from agile_jax.experiment import Experiment
from agile_jax.progress import Progress, silent

if TYPE_CHECKING:
    from agile_jax.policy import TrainedPolicy


def make_dataset(experiment: Experiment, workers: int | None = None, progress: Progress = silent) -> Dataset:
    """The labels that an experiment describes: verified trajectories.

    Args:
        experiment: its scene, expert, dataset and seed are used.
        workers: processes that solve; this one solves when None.
        progress: is told of every label.
    """
    engine = partial(open_engine, "inline" if workers is None else "local", workers)
    with tempfile.TemporaryDirectory(prefix="agile-labels-") as folder:
        generate(experiment, pathlib.Path(folder), engine, progress)
        return load(pathlib.Path(folder) / "dataset")


def train(dataset: Dataset, experiment: Experiment, progress: Progress = silent) -> "TrainedPolicy":
    """Train a policy; its numbers are those of a run with the same settings and labels.

    Args:
        dataset: labels; those to the scene's target are used.
        experiment: its policy and training, and what the labels were made with.
        progress: is told of every epoch.

    Raises:
        BadInput: no label leads to the scene's target, or too few do.
    """
    return training.fit_dataset(dataset, experiment, progress=progress).policy
