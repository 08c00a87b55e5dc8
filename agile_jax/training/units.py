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
import jax.numpy as jnp
import numpy as np

from agile_jax.dataset import Dataset, DatasetSettings, labels, samples, split_mask
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.policy.settings import PolicySettings
from agile_jax.scene import POSE_SIZE
from agile_jax.settings import BadInput
from agile_jax.training.epochs import SI, encode_samples, mean_squared_error
from agile_jax.training.noise_floor import gamma_test
from agile_jax.training.settings import TrainingSettings

SPREAD = 0.01  # of the bound; labels that vary less do not set a unit


class Units(NamedTuple):
    """How labels become outputs of the network."""

    interval: float  # [s] by which labels are divided to be velocities; 1 for velocities
    output: np.ndarray  # u, shape (4,) or (1,) [m/s, rad/s]


def make_units(
    dataset: Dataset,
    dataset_settings: DatasetSettings,
    policy_settings: PolicySettings,
    training_settings: TrainingSettings,
    velocity_limit: np.ndarray,
) -> Units:
    """The units that the settings ask for.

    Raises:
        BadInput: the policy's structure fixes its units already.
    """
    displacement, name = dataset_settings.label_kind == "displacement", training_settings.output_units
    if not displacement and name == "si":
        return Units(1.0, SI)
    if policy_settings.kind != "plain":
        setting = 'dataset.label_kind = "displacement"' if displacement else f'training.output_units = "{name}"'
        raise BadInput(f'{setting} is for policy.kind = "plain"; "{policy_settings.kind}" sets its own units')
    interval = 1.0
    if displacement:
        interval = float(np.diff(dataset.times[split_mask(dataset, "train", dataset_settings)]).mean())
    if name == "si":
        return Units(interval, np.full(POSE_SIZE, 1.0 / interval))
    if name == "limits":
        return Units(interval, np.asarray(velocity_limit, float))
    deviation = samples(dataset, "train", dataset_settings)[1].std(0) / interval
    return Units(interval, np.where(deviation > SPREAD * velocity_limit, deviation, velocity_limit))


def error_on(
    policy: Policy, parameters: PolicyParameters, test: tuple[np.ndarray, np.ndarray], unit: np.ndarray = SI
) -> float:
    """Mean squared error on poses and velocities, in `unit`, shape (4,) [m/s, rad/s]."""

    def error(parameters: PolicyParameters, encoded: object) -> jax.Array:
        return mean_squared_error(policy, parameters, encoded, unit)  # type: ignore[arg-type]

    with jax.default_matmul_precision("float32"):
        return float(jax.jit(error)(parameters, encode_samples(policy, *test)))


def errors_in_own_units(
    policy: Policy, parameters: PolicyParameters, dataset: Dataset, settings: DatasetSettings, units: Units
) -> dict[str, float | None]:
    """Test error and noise floor of what the network learns, in its outputs' units. For a field without a base."""
    poses, targets = samples(dataset, "test", settings)
    held_out = ~split_mask(dataset, "train", settings)
    field = jax.jit(jax.vmap(jax.vmap(lambda pose: policy.output(parameters, policy.encode(pose)))))
    everywhere, wanted = dataset.states[..., :POSE_SIZE], labels(dataset, settings) / units.interval
    keep = slice(None)
    if settings.samples == "without_start":  # trajectories must keep one length: those samples of the shortest rest
        keep = slice(min(int((dataset.times < settings.start_seconds).sum(1).max()), wanted.shape[1] - 1), None)
    everywhere, wanted = everywhere[:, keep], wanted[:, keep]
    # Both err upwards where trajectories are far apart; see stage.dataset_noise_floor.
    floors = [gamma_test(everywhere, wanted / units.output).floor] if len(everywhere) >= 3 else []
    if held_out.sum() >= 3:
        rest = wanted[held_out] - np.asarray(field(jnp.asarray(everywhere[held_out], jnp.float32)))
        floors.append(gamma_test(everywhere[held_out], rest / units.output).floor)
    return {
        "test_mse_own_units": error_on(policy, parameters, (poses, targets / units.interval), units.output),
        "noise_floor_mse_own_units": min(floors, default=None),
    }
