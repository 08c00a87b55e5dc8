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
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, Int32, Key, PRNGKeyArray, PyTree

from agile_jax.arrays import AnyArray
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Encoding, Policy
from agile_jax.settings import BadInput
from agile_jax.single_precision import in_single_precision
from agile_jax.training.optimizer import make_optimizer
from agile_jax.training.precision import Precision, products
from agile_jax.training.samples import SI, Samples, Unit
from agile_jax.training.settings import TrainingSettings

BLOCK = 4096  # samples evaluated at once

SplitRows = Callable[[jax.Array], jax.Array]
"""Asks that the last axis of an array of rows is split among the devices."""
R = TypeVar("R")


class EncodedSamples(NamedTuple):
    """Samples of one split on the device, their inputs encoded."""

    encoding: Encoding  # leaves lead with m
    outputs: Float[Array, "m 4"]  # [m/s, rad/s], or [m/s^2, rad/s^2] of a feedback law


class TrainState(NamedTuple):
    """All that changes during training."""

    parameters: PolicyParameters
    optimizer: PyTree  # Optax's state
    step: Int32[Array, "*seeds"]


Step = Callable[[TrainState, EncodedSamples], tuple[TrainState, jax.Array]]
Epoch = Callable[[TrainState, EncodedSamples, jax.Array, jax.Array], tuple[TrainState, jax.Array]]


@dataclass(frozen=True, eq=False)
class CompiledTraining:
    """An epoch and the validation error, compiled for the shapes of one data set and S seeds.

    Attributes:
        compile_seconds: how long it took [s].
    """

    _epoch: jax.stages.Compiled
    _error: jax.stages.Compiled
    compile_seconds: float

    def epoch(
        self, state: TrainState, samples: EncodedSamples, keys: Key[Array, " S"], number: int
    ) -> tuple[TrainState, Float[Array, "S steps"]]:
        """Train for epoch `number`, from 0; the state is consumed.

        Returns:
            The state, and each step's error before it [(m/s)^2, (rad/s)^2].
        """
        return self._epoch(state, samples, keys, np.int32(number))

    def validation_error(self, parameters: PolicyParameters, samples: EncodedSamples) -> Float[Array, " S"]:
        """The mean squared error of each seed [(m/s)^2, (rad/s)^2]."""
        return self._error(parameters, samples)


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


def encode_samples(policy: Policy, samples: Samples) -> EncodedSamples:
    """Put a split on the device, in float32."""
    encoding = jax.jit(jax.vmap(policy.encode))(jnp.asarray(samples.inputs, jnp.float32))
    return EncodedSamples(encoding, jnp.asarray(samples.outputs, jnp.float32))


def squared(unit: Unit) -> Float[np.ndarray, " n"]:
    """The square of a unit, squared before it is rounded to float32."""
    return np.asarray(np.asarray(unit, np.float64) ** 2, np.float32)


def squared_errors(policy: Policy, parameters: PolicyParameters, samples: EncodedSamples) -> Float[Array, "m 4"]:
    """Squared errors of each sample and output [(m/s)^2, (rad/s)^2]."""
    return (jax.vmap(policy.output, (None, 0))(parameters, samples.encoding) - samples.outputs) ** 2


def mean_squared_error(
    policy: Policy,
    parameters: PolicyParameters,
    samples: EncodedSamples,
    unit: Unit = SI,
    split: SplitRows = lambda rows: rows,
) -> Float[Array, ""]:
    """Mean over samples and outputs of the errors in `unit`, squared; block by block to bound the memory."""
    square_unit = squared(unit)
    count = len(samples.outputs)
    blocks = -(-count // BLOCK)
    rows = jnp.arange(blocks * BLOCK, dtype=jnp.int32).reshape(blocks, BLOCK)

    def block_sum(row: Int[Array, " block"]) -> Float[Array, ""]:
        part = jax.tree.map(lambda leaf: leaf[split(jnp.minimum(row, count - 1))], samples)
        square = (squared_errors(policy, parameters, part) / square_unit).mean(-1)
        return jnp.where(row < count, square, 0.0).sum()

    return jax.lax.map(block_sum, rows).sum() / count


@in_single_precision
def error_on(policy: Policy, parameters: PolicyParameters, test: Samples, unit: Unit = SI) -> float:
    """Mean squared error on samples, in `unit`."""

    def error(parameters: PolicyParameters, encoded: EncodedSamples) -> jax.Array:
        return mean_squared_error(policy, parameters, encoded, unit)

    with jax.default_matmul_precision("float32"):
        return float(jax.jit(error)(parameters, encode_samples(policy, test)))


def of_seed(by_seed: PolicyParameters, number: int) -> PolicyParameters:
    """The parameters of one seed."""
    return jax.tree.map(lambda leaf: leaf[number], by_seed)


def make_step(
    policy: Policy, optimizer: optax.GradientTransformation, precision: Precision | None = "float32", unit: Unit = SI
) -> Step:
    """One step of the optimiser on one batch: (state, batch) -> (state, error before the step [(m/s)^2, (rad/s)^2]).

    Args:
        policy: whose output is fitted.
        optimizer: of Optax.
        precision: of the products (precision.py); None leaves them to the layers.
        unit: in which the errors are squared for the gradient.
    """
    square_unit = squared(unit)

    def step(state: TrainState, batch: EncodedSamples) -> tuple[TrainState, Float[Array, ""]]:
        def loss(network: PyTree) -> tuple[Float[Array, ""], Float[Array, ""]]:
            squares = squared_errors(policy, state.parameters._replace(network=network), batch)
            return (squares / square_unit).mean(), squares.mean()

        with products(precision):
            (_, error), gradient = jax.value_and_grad(loss, has_aux=True)(state.parameters.network)
        updates, optimizer_state = optimizer.update(gradient, state.optimizer, state.parameters.network)
        network = optax.apply_updates(state.parameters.network, updates)
        return TrainState(state.parameters._replace(network=network), optimizer_state, state.step + 1), error

    return step


def steps_per_epoch(count: int, batch_size: int) -> int:
    """Batches that cover `count` samples."""
    return -(-count // batch_size)


def make_epoch(step: Step, count: int, batch_size: int, split: SplitRows = lambda rows: rows) -> Epoch:
    """One epoch of one seed: (state, samples, key, number) -> (state, errors (steps,) [(m/s)^2, (rad/s)^2])."""
    steps = steps_per_epoch(count, batch_size)

    def epoch(
        state: TrainState, samples: EncodedSamples, key: PRNGKeyArray, number: Int32[AnyArray, ""]
    ) -> tuple[TrainState, Float[Array, " steps"]]:
        everything = jnp.arange(count, dtype=jnp.int32)
        order = jax.random.permutation(jax.random.fold_in(key, number), everything)
        again = jnp.arange(steps * batch_size, dtype=jnp.int32) % count
        rows = split(order[again].reshape(steps, batch_size))

        def one(state: TrainState, row: Int32[Array, " batch"]) -> tuple[TrainState, Float[Array, ""]]:
            return step(state, jax.tree.map(lambda leaf: leaf[row], samples))

        return jax.lax.scan(one, state, rows)

    return epoch


def over_seeds(function: Callable[..., R], seeds: int, axes: tuple[int | None, ...]) -> Callable[..., R]:
    """vmap over the leading axis of the arguments whose axis is 0. One seed is not batched: its products stay plain."""
    if seeds > 1:
        return jax.vmap(function, axes)

    def alone(*arguments: PyTree) -> R:
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
    training: EncodedSamples,
    validation: EncodedSamples,
    keys: Key[Array, " S"],
    unit: Unit = SI,
) -> CompiledTraining:
    """Compile ahead of time for these arguments, placed as they are."""
    count, sharding = len(training.outputs), device_sharding(settings.devices)

    def split(rows: jax.Array) -> jax.Array:
        if settings.devices == 1:
            return rows
        spec = PartitionSpec(*[None] * (rows.ndim - 1), "batch")
        return jax.lax.with_sharding_constraint(rows, NamedSharding(sharding.mesh, spec))

    optimizer = make_optimizer(settings, steps_per_epoch(count, settings.batch_size) * settings.epochs)
    epoch = make_epoch(make_step(policy, optimizer, settings.precision, unit), count, settings.batch_size, split)

    def error(parameters: PolicyParameters, samples: EncodedSamples) -> Float[Array, ""]:
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
