"""The compiled parts of the training: one epoch, and the mean squared error over a whole split.

All samples stay on the device. The order of epoch e is jax.random.permutation(fold_in(key, e)) and a batch is a
slice of it: the order is a pure function of (seed, step), so there is no iterator to save. An epoch has ceil(n /
batch) steps; the last batch is filled up from the beginning of the same permutation, so that every sample is seen
and all batches have one shape. Nothing is sent to the host inside an epoch.

Several seeds are trained at once by vmap: every array of the state leads with the seeds. Several devices share each
batch (data parallelism): state and samples are copied to all, the rows of a batch are split among them, and XLA adds
up the gradients.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import NamedSharding, PartitionSpec

from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Encoding, Policy
from agile_jax.settings import BadInput
from agile_jax.training.optimizer import make_optimizer
from agile_jax.training.precision import Precision, products
from agile_jax.training.settings import TrainingSettings

BLOCK = 4096  # samples evaluated at once
SI = np.ones(1)  # unit of the loss: as the labels are

Step = Callable[["TrainState", "Samples"], tuple["TrainState", jax.Array]]
SplitRows = Callable[[jax.Array], jax.Array]  # asks that the last axis of an array of rows is split among the devices


class Samples(NamedTuple):
    """Labels of one split, and what of their poses the field needs."""

    encoding: Encoding  # leaves (m, ...)
    velocities: jax.Array  # (m, 4) [m/s, rad/s]


class TrainState(NamedTuple):
    """All that changes during training."""

    parameters: PolicyParameters
    optimizer: Any
    step: jax.Array  # () int32


class CompiledTraining(NamedTuple):
    """Compiled for the shapes of one data set. States and keys lead with the S seeds."""

    epoch: Callable[..., tuple[TrainState, jax.Array]]  # (state, samples, keys, number) -> state, losses (S, steps)
    validation_error: Callable[[PolicyParameters, Samples], jax.Array]  # (S,)
    compile_seconds: float


def device_sharding(devices: int) -> NamedSharding:
    """Copies on each of the first `devices` devices.

    Raises:
        BadInput: there are fewer.
    """
    found = jax.devices()
    if devices > len(found):
        raise BadInput(f"training.devices = {devices}, but JAX finds {len(found)} ({found[0].platform})")
    mesh = jax.sharding.Mesh(np.array(found[:devices]), ("batch",))
    return NamedSharding(mesh, PartitionSpec())


def encode_samples(policy: Policy, poses: np.ndarray, velocities: np.ndarray) -> Samples:
    """Put a split on the device. Shapes (m, 4)."""
    encoding = jax.jit(jax.vmap(policy.encode))(jnp.asarray(poses, jnp.float32))
    return Samples(encoding, jnp.asarray(velocities, jnp.float32))


def squared_errors(policy: Policy, parameters: PolicyParameters, samples: Samples) -> jax.Array:
    """Squared errors of each sample and output, shape (m, 4) [(m/s)^2, (rad/s)^2]."""
    return (jax.vmap(policy.output, (None, 0))(parameters, samples.encoding) - samples.velocities) ** 2


def mean_squared_error(
    policy: Policy,
    parameters: PolicyParameters,
    samples: Samples,
    unit: np.ndarray = SI,
    split: SplitRows = lambda rows: rows,
) -> jax.Array:
    """Mean over samples and outputs, in `unit` ([m/s, rad/s], shape (4,)), block by block to bound the memory."""
    count = len(samples.velocities)
    blocks = -(-count // BLOCK)
    rows = jnp.arange(blocks * BLOCK).reshape(blocks, BLOCK)

    def block_sum(row: jax.Array) -> jax.Array:
        part = jax.tree.map(lambda leaf: leaf[split(jnp.minimum(row, count - 1))], samples)
        square = (squared_errors(policy, parameters, part) / unit**2).mean(-1)
        return jnp.where(row < count, square, 0.0).sum()

    return jax.lax.map(block_sum, rows).sum() / count


def make_step(
    policy: Policy, optimizer: optax.GradientTransformation, precision: Precision = "float32", unit: np.ndarray = SI
) -> Step:
    """One step of the optimiser on one batch: (state, batch) -> (state, error before the step [(m/s)^2, (rad/s)^2]).

    Args:
        policy: whose field is fitted.
        optimizer: of Optax.
        precision: of the products (precision.py).
        unit: in which the errors are squared, shape (4,) [m/s, rad/s].
    """

    def step(state: TrainState, batch: Samples) -> tuple[TrainState, jax.Array]:
        def loss(network: Any) -> tuple[jax.Array, jax.Array]:
            squares = squared_errors(policy, state.parameters._replace(network=network), batch)
            return (squares / unit**2).mean(), squares.mean()

        with products(precision):
            (_, error), gradient = jax.value_and_grad(loss, has_aux=True)(state.parameters.network)
        updates, optimizer_state = optimizer.update(gradient, state.optimizer, state.parameters.network)
        network = optax.apply_updates(state.parameters.network, updates)
        return TrainState(state.parameters._replace(network=network), optimizer_state, state.step + 1), error

    return step


def steps_per_epoch(count: int, batch_size: int) -> int:
    """Batches that cover `count` samples."""
    return -(-count // batch_size)


def make_epoch(step: Step, count: int, batch_size: int, split: SplitRows) -> Callable[..., Any]:
    """One epoch of one seed: (state, samples, key, number) -> (state, losses (steps,))."""
    steps = steps_per_epoch(count, batch_size)

    def epoch(state: TrainState, samples: Samples, key: jax.Array, number: jax.Array) -> tuple[TrainState, jax.Array]:
        order = jax.random.permutation(jax.random.fold_in(key, number), count)
        rows = split(order[jnp.arange(steps * batch_size) % count].reshape(steps, batch_size))

        def one(state: TrainState, row: jax.Array) -> tuple[TrainState, jax.Array]:
            return step(state, jax.tree.map(lambda leaf: leaf[row], samples))

        return jax.lax.scan(one, state, rows)

    return epoch


def over_seeds(function: Callable[..., Any], seeds: int, axes: tuple[int | None, ...]) -> Callable[..., Any]:
    """vmap over the leading axis of the arguments whose axis is 0. One seed is not batched: its products stay plain."""
    if seeds > 1:
        return jax.vmap(function, axes)

    def alone(*arguments: Any) -> Any:
        first = [
            jax.tree.map(lambda leaf: leaf[0], argument) if axis == 0 else argument
            for argument, axis in zip(arguments, axes, strict=True)
        ]
        return jax.tree.map(lambda leaf: leaf[None], function(*first))

    return alone


def compile_training(
    policy: Policy,
    settings: TrainingSettings,
    state: TrainState,
    training: Samples,
    validation: Samples,
    keys: jax.Array,
    unit: np.ndarray = SI,
) -> CompiledTraining:
    """Compile ahead of time for these arguments, placed as they are; the state given to `epoch` is consumed."""
    count, sharding = len(training.velocities), device_sharding(settings.devices)

    def split(rows: jax.Array) -> jax.Array:
        if settings.devices == 1:
            return rows
        spec = PartitionSpec(*[None] * (rows.ndim - 1), "batch")
        return jax.lax.with_sharding_constraint(rows, NamedSharding(sharding.mesh, spec))

    optimizer = make_optimizer(settings, steps_per_epoch(count, settings.batch_size) * settings.epochs)
    epoch = make_epoch(make_step(policy, optimizer, settings.precision, unit), count, settings.batch_size, split)

    def error(parameters: PolicyParameters, samples: Samples) -> jax.Array:
        return mean_squared_error(policy, parameters, samples, split=split)

    start = time.perf_counter()
    compiled = (
        jax.jit(over_seeds(epoch, settings.seeds, (0, None, 0, None)), donate_argnums=0, out_shardings=sharding)
        .lower(state, training, keys, jnp.int32(0))
        .compile()
    )
    with jax.default_matmul_precision("float32"):
        validation_error = (
            jax.jit(over_seeds(error, settings.seeds, (0, None)), out_shardings=sharding)
            .lower(state.parameters, validation)
            .compile()
        )
    return CompiledTraining(compiled, validation_error, time.perf_counter() - start)
