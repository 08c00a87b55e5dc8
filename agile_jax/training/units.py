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

import jax
import numpy as np
from jaxtyping import Float

from agile_jax.dataset import Dataset, DatasetSettings, samples, split_mask
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.policy.single_precision import in_single_precision
from agile_jax.scene import POSE_SIZE
from agile_jax.training.epochs import SI, EncodedSamples, Unit, encode_samples, mean_squared_error
from agile_jax.training.samples import Samples
from agile_jax.training.settings import TrainingSettings

SPREAD = 0.01  # of the bound; labels that vary less do not set a unit


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


@in_single_precision
def error_on(policy: Policy, parameters: PolicyParameters, test: Samples, unit: Unit = SI) -> float:
    """Mean squared error on samples, in `unit`."""

    def error(parameters: PolicyParameters, encoded: EncodedSamples) -> jax.Array:
        return mean_squared_error(policy, parameters, encoded, unit)

    with jax.default_matmul_precision("float32"):
        return float(jax.jit(error)(parameters, encode_samples(policy, test)))
