"""The multilayer perceptron and the parameters that travel with it.

    y = scale * (W_L a(... a(W_1 (f - mean) / std + b_1) ...) + b_L)

f are the inputs, a the activation. Mean, std and scale are part of the parameters, so that a checkpoint is
complete, but are not trained.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

Initialisation = Literal["glorot_uniform", "he_normal", "lecun_normal", "torch_uniform"]

ACTIVATIONS: dict[str, Callable[[jax.Array], jax.Array]] = {
    "tanh": jnp.tanh,
    "softplus": nn.softplus,
    "gelu": nn.gelu,
    "relu": nn.relu,
}

KERNELS: dict[str, Callable[..., jax.Array]] = {  # biases are 0
    "glorot_uniform": nn.initializers.glorot_uniform(),
    "he_normal": nn.initializers.he_normal(),
    "lecun_normal": nn.initializers.lecun_normal(),
}


class Normalization(NamedTuple):
    """Units of the network's inputs and outputs."""

    mean: Float[Array, " f"]  # in the features' units, as the next
    std: Float[Array, " f"]
    scale: Float[Array, " outputs"]  # [m/s, rad/s], or [m/s^2, rad/s^2] of a feedback law


class PolicyParameters(NamedTuple):
    """All that a trained policy consists of."""

    network: PyTree[Float[Array, "..."]]  # as Flax names it: {"params": {"Dense_0": {"kernel", "bias"}, ...}}
    normalization: Normalization


def uniform_fan_in(
    key: PRNGKeyArray, shape: tuple[int, ...], fan_in: int, dtype: DTypeLike = jnp.float32
) -> Float[Array, "..."]:
    """Random numbers of the given shape, uniform in +-1 / sqrt(fan_in)."""
    bound = 1.0 / np.sqrt(fan_in)
    return jax.random.uniform(key, shape, dtype, -bound, bound)


class MLP(nn.Module):
    """Fully connected layers with an activation between them; the last is linear."""

    layers: tuple[int, ...]  # widths, the output's included
    activation: str
    initialisation: Initialisation = "lecun_normal"

    @nn.compact
    def __call__(self, x: Float[Array, "*batch inputs"]) -> Float[Array, "*batch outputs"]:
        """Normalised features to outputs of no unit, layers[-1] many."""
        for i, width in enumerate(self.layers):
            if self.initialisation == "torch_uniform":
                fan_in = x.shape[-1]
                layer = nn.Dense(
                    width,
                    kernel_init=lambda key, shape, dtype, n=fan_in: uniform_fan_in(key, shape, n, dtype),
                    bias_init=lambda key, shape, dtype, n=fan_in: uniform_fan_in(key, shape, n, dtype),
                )
            else:
                layer = nn.Dense(width, kernel_init=KERNELS[self.initialisation])
            x = layer(x)
            if i + 1 < len(self.layers):
                x = ACTIVATIONS[self.activation](x)
        return x


def fit_normalization(
    features: Float[np.ndarray, "m f"], natural_range: Float[np.ndarray, " f"], scale: Float[np.ndarray, " outputs"]
) -> Normalization:
    """Mean and standard deviation of the inputs.

    An input that hardly varies (the yaw of the paper's data is constant) is divided by its natural range instead:
    divided by its own spread, it would explode as soon as it leaves the data.

    Args:
        features: of m samples, in their units.
        natural_range: half of what each feature can span, in its unit.
        scale: unit of the outputs [m/s, rad/s], or [m/s^2, rad/s^2] of a feedback law.
    """
    mean, std = features.mean(0, dtype=np.float64), features.std(0, dtype=np.float64)
    std = np.where(std > 0.01 * natural_range, std, natural_range)
    as_float32 = [jnp.asarray(x, jnp.float32) for x in (mean, std, scale)]
    return Normalization(*as_float32)


def parameter_count(parameters: PolicyParameters) -> int:
    """How many numbers are trained."""
    return sum(leaf.size for leaf in jax.tree.leaves(parameters.network))
