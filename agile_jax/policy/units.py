"""In which unit the network's outputs are, and the loss squares its errors.

A mean squared error is a number in a unit. With u the unit of an output in m/s (rad/s), the network learns v / u:

    velocity,     si      u = 1
    velocity,     std     u = standard deviation of the labels
    velocity,     limits  u = bound V of the velocity
    displacement          labels are displacements d to the next node. A field gives velocities, so it learns d / h,
                          with h the mean time between nodes, in the unit 1 / h (std, limits: that of d / h, as above)

An output whose labels hardly vary, such as the yaw of the paper's data, takes its bound instead of its deviation.
"""

from typing import NamedTuple

import numpy as np

from agile_jax.dataset import Dataset, DatasetSettings, samples, split_mask
from agile_jax.dataset.dataset import SPLITS
from agile_jax.policy.settings import PolicySettings, TrainingSettings
from agile_jax.settings import BadInput

SPREAD = 0.01  # of the bound; labels that vary less do not set a unit


class LabelledSplits(NamedTuple):
    """Poses and labels of each split, labels as velocities, and the unit of the network's outputs."""

    train: tuple[np.ndarray, np.ndarray]  # (m, 4) [m, rad], (m, 4) [m/s, rad/s]
    validation: tuple[np.ndarray, np.ndarray]
    test: tuple[np.ndarray, np.ndarray]
    unit: np.ndarray  # (4,) [m/s, rad/s]
    interval: float  # between nodes, mean of the training split [s]


def labelled_splits(
    dataset: Dataset,
    dataset_settings: DatasetSettings,
    policy_settings: PolicySettings,
    training_settings: TrainingSettings,
    velocity_limit: np.ndarray,
) -> LabelledSplits:
    """What is trained on, in which unit.

    Raises:
        BadInput: a unit that the policy's structure fixes already.
    """
    displacement, units = dataset_settings.target == "displacement", training_settings.output_units
    if policy_settings.kind != "plain" and (displacement or units != "si"):
        setting = 'dataset.target = "displacement"' if displacement else f'training.output_units = "{units}"'
        raise BadInput(f'{setting} is for policy.kind = "plain"; "{policy_settings.kind}" sets its own units')
    interval = float(np.diff(dataset.times[split_mask(dataset, "train", dataset_settings)]).mean())
    parts = {}
    for split in SPLITS:
        poses, labels = samples(dataset, split, dataset_settings)
        parts[split] = (poses, labels / interval if displacement else labels)
    unit = np.full(len(velocity_limit), 1.0 / interval if displacement else 1.0)
    if units == "limits":
        unit = np.asarray(velocity_limit, float)
    elif units == "std":
        deviation = parts["train"][1].std(0)
        unit = np.where(deviation > SPREAD * velocity_limit, deviation, velocity_limit)
    return LabelledSplits(parts["train"], parts["validation"], parts["test"], unit, interval)
