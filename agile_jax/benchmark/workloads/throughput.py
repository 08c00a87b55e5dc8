"""What `agile benchmark training` times: the training's own steps, and the matrix products that they consist of.

Labels and parameters are random: the time of a step does not depend on them. `Workload` holds everything as NumPy
arrays, so that another framework can do the very same steps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, PyTree

from agile_jax.expert import MotionLimits
from agile_jax.policy.kinds import make_policy
from agile_jax.policy.policy import Encoding
from agile_jax.policy.settings import PolicySettings
from agile_jax.scene import POSE_SIZE, SceneSettings, make_scene
from agile_jax.training.epochs import EncodedSamples, TrainState, make_epoch, make_step
from agile_jax.training.optimizer import make_optimizer
from agile_jax.training.precision import Precision
from agile_jax.training.settings import TrainingSettings


class Workload(NamedTuple):
    """A few steps of training the plain field: SGD on the mean squared error."""

    poses: Float[np.ndarray, "m 4"]  # of no unit, as the labels
    labels: Float[np.ndarray, "m 4"]
    rows: Int[np.ndarray, "steps batch"]  # of the samples
    kernels: list[Float[np.ndarray, "inputs outputs"]]  # of each layer
    biases: list[Float[np.ndarray, " outputs"]]
    learning_rate: float


@dataclass(frozen=True, eq=False)
class Product:
    """One matrix product of a step, compiled for its operands.

    Attributes:
        name: form and sizes.
        flops: floating-point operations.
    """

    name: str
    flops: float
    _compiled: jax.stages.Compiled
    _operands: tuple[jax.Array, ...]

    def run(self) -> None:
        """Multiply, and wait for it."""
        jax.block_until_ready(self._compiled(*self._operands))


@dataclass(frozen=True, eq=False)
class Run:
    """The work, compiled."""

    _compiled: jax.stages.Compiled
    _first: TrainState
    _rest: tuple[PyTree, ...]

    def prepare(self) -> TrainState:
        """The beginning, not to be timed; a copy, since a run consumes it."""
        return jax.block_until_ready(jax.tree.map(jnp.copy, self._first))

    def work(self, state: TrainState) -> Float[np.ndarray, " steps"]:
        """The losses of all steps."""
        _, losses = jax.block_until_ready(self._compiled(state, *self._rest))
        return np.asarray(losses)


def make_workload(
    policy: PolicySettings, training: TrainingSettings, steps: int
) -> tuple[Workload, Callable[[Precision | None], Run]]:
    """The work, and a function that compiles it in a precision; None leaves the products to the layers.

    Args:
        policy: hidden layers and activation; the field is always the plain one on raw inputs.
        training: batch, learning rate and initialisation; the optimiser is SGD with a constant rate.
        steps: of one run.
    """
    policy = policy.model_copy(update={"kind": "plain", "normalize_inputs": False})
    training = TrainingSettings(
        optimizer="sgd",
        schedule="constant",
        learning_rate=training.learning_rate,
        batch_size=training.batch_size,
        initialisation=training.initialisation,
    )
    limits = MotionLimits(np.ones(POSE_SIZE), np.ones(POSE_SIZE))
    field = make_policy(make_scene(SceneSettings()), limits, policy)
    generator = np.random.default_rng(0)
    poses = generator.normal(size=(steps * training.batch_size, POSE_SIZE)).astype(np.float32)
    labels = np.tanh(poses[:, ::-1])
    parameters = field.init(jax.random.key(0), training.initialisation)
    key = jax.random.key(1)
    order = np.asarray(jax.random.permutation(jax.random.fold_in(key, 0), len(poses)))
    layers = [parameters.network["params"][f"Dense_{i}"] for i in range(len(policy.hidden_layers) + 1)]
    workload = Workload(
        poses,
        labels,
        order.reshape(steps, training.batch_size),
        [np.asarray(layer["kernel"]) for layer in layers],
        [np.asarray(layer["bias"]) for layer in layers],
        training.learning_rate,
    )
    zeros, ones = jnp.zeros((len(poses), POSE_SIZE), jnp.float32), jnp.ones((len(poses), 1), jnp.float32)
    samples = EncodedSamples(Encoding(jnp.asarray(poses), zeros, ones), jnp.asarray(labels))
    optimizer = make_optimizer(training, steps)

    def compiled(precision: Precision | None) -> Run:
        step = make_step(field, optimizer, precision)
        epoch = make_epoch(step, len(poses), training.batch_size)
        first = TrainState(parameters, optimizer.init(parameters.network), jnp.int32(0))
        rest = samples, key, jnp.int32(0)
        return Run(jax.jit(epoch, donate_argnums=0).lower(first, *rest).compile(), first, rest)

    return workload, compiled


def step_flops(workload: Workload) -> float:
    """Floating-point operations in the matrix products of one step; the first layer's inputs need no gradient."""
    sizes = [2.0 * workload.rows.shape[1] * kernel.size for kernel in workload.kernels]
    return 3.0 * sum(sizes) - sizes[0]


def make_products(workload: Workload) -> list[Product]:
    """Every product of a step by itself, in float32 as jnp.matmul computes it: x w, g w^T and x^T g of each layer."""
    batch = workload.rows.shape[1]
    forms = {
        "x w": lambda x, w, g: x @ w,
        "g w^T": lambda x, w, g: g @ w.T,
        "x^T g": lambda x, w, g: x.T @ g,
    }
    generator = np.random.default_rng(0)
    compiled = {name: jax.jit(form) for name, form in forms.items()}
    products = []
    for number, kernel in enumerate(workload.kernels):
        inputs, outputs = kernel.shape
        x, g = (jnp.asarray(generator.normal(size=(batch, width)), jnp.float32) for width in kernel.shape)
        operands = x, jnp.asarray(kernel), g
        for name, product in compiled.items():
            if number == 0 and name == "g w^T":
                continue
            with jax.default_matmul_precision("float32"):
                exact = product.lower(*operands).compile()
            flops = 2.0 * batch * inputs * outputs
            products.append(Product(f"{name} {batch}x{inputs}x{outputs}", flops, exact, operands))
    return products
