"""Samples: what a policy learns from, out of the dataset's trajectories."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.dataset import Dataset, DatasetSettings, Split, labels, samples, split_mask
from agile_jax.policy.policy import Policy
from agile_jax.scene import POSE_SIZE
from agile_jax.settings import BadInput


class Samples(NamedTuple):
    """Inputs of a policy and the outputs that it shall have there (`Policy.learns`).

    Of trajectories instead of single samples, both lead with (trajectories, nodes).
    """

    inputs: Float[np.ndarray, "*samples n"]  # poses, n = 4 [m, rad]; or states, n = 8 [m, rad, m/s, rad/s]
    outputs: Float[np.ndarray, "*samples 4"]  # velocities [m/s, rad/s]; or accelerations [m/s^2, rad/s^2]


def check_samples(given: Samples, name: str) -> None:
    """Refuse a split that is empty or holds a number that is not finite (BadInput)."""
    if len(given.inputs) == 0:
        raise BadInput(f"the {name} split is empty; generate more trajectories (dataset.trajectories)")
    for array, what in zip(given, ("an input", "an output"), strict=True):
        bad = ~np.isfinite(array).all(-1)
        if bad.any():
            raise BadInput(f"the {name} split has {what} that is not finite, first in sample {int(bad.argmax())}")


def policy_samples(policy: Policy, dataset: Dataset, split: Split, settings: DatasetSettings) -> Samples:
    """What a policy learns from a split: velocities (or displacements [m, rad]) of poses, or accelerations of states.

    Raises:
        BadInput: another reading of the labels than a feedback law has.
    """
    if policy.learns == "velocity":
        return Samples(*samples(dataset, split, settings))
    if settings.split_by != "trajectory" or settings.label_kind != "velocity":
        raise BadInput(
            'dataset.split_by = "sample" and dataset.label_kind = "displacement" are for policies of velocities'
        )
    chosen = split_mask(dataset, split, settings)
    states, controls = (array[chosen] for array in _accelerations(dataset))
    keep = np.ones(states.shape[:2], bool)
    if settings.samples == "without_start":
        keep = dataset.times[chosen][:, : states.shape[1]] >= settings.start_seconds
    return Samples(states[keep], controls[keep])


def trajectory_samples(policy: Policy, dataset: Dataset, settings: DatasetSettings) -> Samples:
    """All samples by trajectory (n, nodes, ...); a displacement policy's outputs are displacements [m, rad].

    Trajectories keep one length: with samples = "without_start", those samples that the shortest start leaves.
    """
    if policy.learns == "velocity":
        inputs, outputs = dataset.states[..., :POSE_SIZE], labels(dataset, settings)
    else:
        inputs, outputs = _accelerations(dataset)
    first = 0
    if settings.samples == "without_start":
        first = min(int((dataset.times < settings.start_seconds).sum(1).max()), inputs.shape[1] - 1)
    return Samples(inputs[:, first:], outputs[:, first:])


def _accelerations(dataset: Dataset) -> Samples:
    """States and accelerations by trajectory; piecewise constant ones have none after the last node."""
    count = min(dataset.controls.shape[1], dataset.states.shape[1])
    return Samples(dataset.states[:, :count], dataset.controls[:, :count])
