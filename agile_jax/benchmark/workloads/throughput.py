"""What `agile benchmark training` times: the training's own steps, and the matrix products that they consist of.

Labels and parameters are random: the time of a step does not depend on them. `Workload` holds everything as NumPy
arrays, so that another framework can do the very same steps.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.expert import MotionLimits
from agile_jax.policy.kinds import make_policy
from agile_jax.policy.policy import Encoding
from agile_jax.policy.settings import PolicySettings
from agile_jax.scene import POSE_SIZE, SceneSettings, make_scene
from agile_jax.training.epochs import Samples, TrainState, make_epoch, make_step
from agile_jax.training.optimizer import make_optimizer
from agile_jax.training.precision import Precision
from agile_jax.training.settings import TrainingSettings


class Workload(NamedTuple):
    """A few steps of training the plain field: SGD on the mean squared error."""

    poses: np.ndarray  # (m, 4)
    labels: np.ndarray  # (m, 4)
    rows: np.ndarray  # (steps, batch) of the samples
    kernels: list[np.ndarray]  # (inputs, outputs) of each layer
    biases: list[np.ndarray]
    learning_rate: float


class Product(NamedTuple):
    """One matrix product of a step."""

    name: str
    flops: float
    run: Callable[[], None]


class Run(NamedTuple):
    """The work, compiled."""

    prepare: Callable[[], TrainState]  # the beginning; not to be timed
    work: Callable[[TrainState], np.ndarray]  # to the losses, shape (steps,)


def make_workload(
    policy: PolicySettings, training: TrainingSettings, steps: int
) -> tuple[Workload, Callable[[Precision], Run]]:
    """The work, and a function that compiles it in a precision.

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
    encoding = Encoding(jnp.asarray(poses), jnp.zeros((len(poses), POSE_SIZE)), jnp.ones((len(poses), 1)))
    samples = Samples(encoding, jnp.asarray(labels))
    optimizer = make_optimizer(training, steps)

    def compiled(precision: Precision) -> Run:
        step = make_step(field, optimizer, precision)
        epoch = make_epoch(step, len(poses), training.batch_size, lambda rows: rows)
        first = TrainState(parameters, optimizer.init(parameters.network), jnp.int32(0))
        run = jax.jit(epoch, donate_argnums=0).lower(first, samples, key, jnp.int32(0)).compile()

        def prepare() -> TrainState:  # a copy, since a run consumes it
            return jax.block_until_ready(jax.tree.map(jnp.copy, first))

        def work(state: TrainState) -> np.ndarray:
            state, losses = jax.block_until_ready(run(state, samples, key, jnp.int32(0)))
            return np.asarray(losses)

        return Run(prepare, work)

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

            def run(exact: Callable = exact, operands: tuple = operands) -> None:
                jax.block_until_ready(exact(*operands))

            products.append(Product(f"{name} {batch}x{inputs}x{outputs}", 2.0 * batch * inputs * outputs, run))
    return products
