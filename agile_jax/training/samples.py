"""Samples: what a policy learns from, out of the dataset's trajectories, and in which unit the network's outputs are.

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
from jaxtyping import Float

from agile_jax.dataset import Dataset, DatasetSettings, Split, labels, samples, split_mask
from agile_jax.policy.policy import Policy
from agile_jax.scene import POSE_SIZE
from agile_jax.settings import BadInput
from agile_jax.training.settings import TrainingSettings

SPREAD = 0.01  # of the bound; labels that vary less do not set a unit
SI = np.ones(1)  # unit of the loss: as the outputs are

Unit = Float[np.ndarray, "4"] | Float[np.ndarray, "1"]
"""In which errors are squared, by output or one for all [m/s, rad/s], or [m/s^2, rad/s^2] of a feedback law."""


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


class Units(NamedTuple):
    """How labels become outputs of the network."""

    interval: float  # [s] by which labels are divided to be velocities; 1 for velocities
    output: Unit  # u [m/s, rad/s]

    def outputs(self, given: Samples) -> Samples:
        """Samples whose outputs are labels, with velocities [m/s, rad/s] as outputs."""
        return given._replace(outputs=given.outputs / self.interval)


def make_units(
    dataset: Dataset,
    dataset_settings: DatasetSettings,
    training_settings: TrainingSettings,
    velocity_limit: Float[np.ndarray, "4"],
) -> Units:
    """The units that the settings ask for; `velocity_limit` is the labels' [m/s, rad/s].

    Other policies than the plain field set their own units: an experiment asks others of that kind alone.
    """
    displacement, name = dataset_settings.label_kind == "displacement", training_settings.output_units
    if not displacement and name == "si":
        return Units(1.0, SI)
    interval = 1.0
    if displacement:
        interval = float(np.diff(dataset.times[split_mask(dataset, "train", dataset_settings)]).mean())
    if name == "si":
        return Units(interval, np.full(POSE_SIZE, 1.0 / interval))
    if name == "limits":
        return Units(interval, np.asarray(velocity_limit, float))
    deviation = samples(dataset, "train", dataset_settings)[1].std(0) / interval
    return Units(interval, np.where(deviation > SPREAD * velocity_limit, deviation, velocity_limit))
