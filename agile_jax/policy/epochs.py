"""The compiled parts of the training: one epoch, and the mean squared error over a whole split.

All samples stay on the device. The order of epoch e is jax.random.permutation(fold_in(key, e)) and a batch is a
slice of it: the order is a pure function of (seed, step), so there is no iterator to save. An epoch has ceil(n /
batch) steps; the last batch is filled up from the beginning of the same permutation, so that every sample is seen
and all batches have one shape.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from agile_jax.policy.field import Encoding, Policy
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.optimizer import make_optimizer
from agile_jax.policy.settings import TrainingSettings

BLOCK = 4096  # samples evaluated at once


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
    """Compiled for the shapes of one data set."""

    epoch: Callable[[TrainState, Samples, jax.Array, jax.Array], tuple[TrainState, jax.Array]]
    train_error: Callable[[PolicyParameters, Samples], jax.Array]
    validation_error: Callable[[PolicyParameters, Samples], jax.Array]
    compile_seconds: float


def encode_samples(policy: Policy, poses: np.ndarray, velocities: np.ndarray) -> Samples:
    """Put a split on the device. Shapes (m, 4)."""
    encoding = jax.jit(jax.vmap(policy.encode))(jnp.asarray(poses, jnp.float32))
    return Samples(encoding, jnp.asarray(velocities, jnp.float32))


def loss(policy: Policy, parameters: PolicyParameters, samples: Samples) -> jax.Array:
    """Mean over samples and outputs of the squared error [(m/s)^2, (rad/s)^2]."""
    predicted = jax.vmap(policy.field, (None, 0))(parameters, samples.encoding)
    return jnp.mean((predicted - samples.velocities) ** 2)


def mean_squared_error(policy: Policy, parameters: PolicyParameters, samples: Samples) -> jax.Array:
    """The loss over all samples, block by block so that memory does not grow with their number."""
    count = len(samples.velocities)
    blocks = -(-count // BLOCK)
    rows = jnp.arange(blocks * BLOCK).reshape(blocks, BLOCK)

    def block_sum(row: jax.Array) -> jax.Array:
        part = jax.tree.map(lambda leaf: leaf[jnp.minimum(row, count - 1)], samples)
        predicted = jax.vmap(policy.field, (None, 0))(parameters, part.encoding)
        square = ((predicted - part.velocities) ** 2).mean(-1)
        return jnp.where(row < count, square, 0.0).sum()

    return jax.lax.map(block_sum, rows).sum() / count


def make_step(
    policy: Policy, optimizer: optax.GradientTransformation
) -> Callable[[TrainState, Samples], tuple[TrainState, jax.Array]]:
    """One step of the optimiser on one batch: (state, batch) -> (state, loss before the step)."""

    def step(state: TrainState, batch: Samples) -> tuple[TrainState, jax.Array]:
        def network_loss(network: Any) -> jax.Array:
            return loss(policy, state.parameters._replace(network=network), batch)

        value, gradient = jax.value_and_grad(network_loss)(state.parameters.network)
        updates, optimizer_state = optimizer.update(gradient, state.optimizer, state.parameters.network)
        network = optax.apply_updates(state.parameters.network, updates)
        return TrainState(state.parameters._replace(network=network), optimizer_state, state.step + 1), value

    return step


def steps_per_epoch(count: int, batch_size: int) -> int:
    """Batches that cover `count` samples."""
    return -(-count // batch_size)


def compile_training(
    policy: Policy,
    settings: TrainingSettings,
    state: TrainState,
    training: Samples,
    validation: Samples,
) -> CompiledTraining:
    """Compile ahead of time for these shapes; the state given to `epoch` is consumed."""
    count = len(training.velocities)
    steps = steps_per_epoch(count, settings.batch_size)
    step = make_step(policy, make_optimizer(settings, steps * settings.epochs))

    def epoch(state: TrainState, samples: Samples, key: jax.Array, number: jax.Array) -> tuple[TrainState, jax.Array]:
        order = jax.random.permutation(jax.random.fold_in(key, number), count)
        rows = order[jnp.arange(steps * settings.batch_size) % count].reshape(steps, settings.batch_size)

        def one(state: TrainState, row: jax.Array) -> tuple[TrainState, jax.Array]:
            return step(state, jax.tree.map(lambda leaf: leaf[row], samples))

        return jax.lax.scan(one, state, rows)

    def error(parameters: PolicyParameters, samples: Samples) -> jax.Array:
        return mean_squared_error(policy, parameters, samples)

    start = time.perf_counter()
    with jax.default_matmul_precision(settings.precision):
        compiled = jax.jit(epoch, donate_argnums=0).lower(state, training, jax.random.key(0), jnp.int32(0)).compile()
    with jax.default_matmul_precision("float32"):
        errors = [jax.jit(error).lower(state.parameters, samples).compile() for samples in (training, validation)]
    return CompiledTraining(compiled, errors[0], errors[1], time.perf_counter() - start)
