"""Fitting the network to samples: resumable, bit for bit.

The parameters after epoch e are a pure function of (samples, settings, seed). A killed training goes on from its
last checkpoint and ends with the same parameters, the same optimiser state and the same metrics.jsonl as one that
was not killed (on a CPU; a GPU needs XLA's deterministic kernels for that).
"""

import pathlib
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.checkpoint import Checkpoint, restore_checkpoint, save_checkpoint
from agile_jax.policy.epochs import CompiledTraining, TrainState, compile_training, encode_samples, steps_per_epoch
from agile_jax.policy.field import Policy
from agile_jax.policy.metrics import MetricsLog
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.optimizer import make_optimizer, make_schedule
from agile_jax.policy.settings import TrainingSettings
from agile_jax.progress import Progress, silent
from agile_jax.settings import BadInput

Labels = tuple[np.ndarray, np.ndarray]  # poses (m, 4) [m, rad], velocities (m, 4) [m/s, rad/s]
Watch = Callable[[PolicyParameters], dict[str, float]]


class Fitted(NamedTuple):
    """The outcome of a training."""

    parameters: PolicyParameters
    train_mse: float  # over the whole split, with the final parameters
    validation_mse: float
    seconds: float  # in epochs, over all resumptions, compilation apart
    compile_seconds: float  # in this process
    rows: list[dict[str, Any]]  # of metrics.jsonl


def fit_policy(
    policy: Policy,
    training: Labels,
    validation: Labels,
    settings: TrainingSettings,
    identity: dict[str, Any],
    seed: int,
    directory: pathlib.Path,
    progress: Progress = silent,
    watch: tuple[int, Watch] | None = None,
    initial: PolicyParameters | None = None,
) -> Fitted:
    """Fit the policy's network, going on from the last checkpoint in `directory` when there is one.

    Args:
        policy: the field.
        training, validation: poses and velocities.
        settings: how.
        identity: JSON that describes samples and policy; with settings and seed it must equal that of the checkpoint.
        seed: of the initial parameters and of the order of the samples.
        directory: for metrics.jsonl, tensorboard/ and checkpoints/.
        progress: is told of every epoch.
        watch: every so many epochs, what it finds of the parameters joins the row of metrics.jsonl.
        initial: parameters to begin with; random ones, and the samples' normalisation, when not given.

    Raises:
        BadInput: empty or non-finite samples, a batch larger than the samples, a checkpoint of other settings, or a
            loss that is not finite.
    """
    check_labels(training, "training")
    check_labels(validation, "validation")
    if settings.batch_size > len(training[0]):
        raise BadInput(
            f"training.batch_size = {settings.batch_size} is larger than the {len(training[0])} training samples; "
            "lower it or generate more trajectories"
        )
    # What can change without changing the result is not part of the identity.
    fixed = settings.model_dump(mode="json", exclude={"checkpoint_every", "keep"})
    identity = identity | {"training": fixed, "seed": seed}
    folder = directory / "checkpoints"
    state, key, samples, held_out = _prepare(policy, training, validation, settings, seed, initial)
    restored = restore_checkpoint(folder, state.parameters, state.optimizer, identity)
    steps = steps_per_epoch(len(training[0]), settings.batch_size)
    epoch, rows, seconds = 0, [], 0.0
    if restored is not None:
        epoch, rows, seconds = restored.step, restored.metadata["rows"], restored.metadata["seconds"]
        state = TrainState(restored.parameters, restored.optimizer, jnp.int32(epoch * steps))
    progress(epoch, settings.epochs, "training: compiling")
    compiled = compile_training(policy, settings, state, samples, held_out)
    schedule = make_schedule(settings, steps * settings.epochs)
    with MetricsLog(directory, rows) as log:
        for number in range(epoch, settings.epochs):
            start = time.perf_counter()
            state, losses = compiled.epoch(state, samples, key, jnp.int32(number))
            row = _row(compiled, state, np.asarray(losses), held_out, number, steps)
            row["learning_rate"] = float(schedule(row["step"] - 1))  # of the last step taken
            if watch is not None and (number + 1) % watch[0] == 0:
                row |= watch[1](state.parameters)
            log.append(row)
            seconds += time.perf_counter() - start
            done = number + 1
            if done % settings.checkpoint_every == 0 or done == settings.epochs:
                metadata = {"rows": log.rows, "seconds": seconds}
                save_checkpoint(
                    folder, Checkpoint(done, state.parameters, state.optimizer, metadata), identity, settings.keep
                )
            progress(done, settings.epochs, f"training: validation error {row['validation_mse']:.2e}")
        return Fitted(
            parameters=state.parameters,
            train_mse=float(compiled.train_error(state.parameters, samples)),
            validation_mse=float(compiled.validation_error(state.parameters, held_out)),
            seconds=seconds,
            compile_seconds=compiled.compile_seconds,
            rows=log.rows,
        )


def check_labels(labels: Labels, name: str) -> None:
    """Refuse a split that is empty or holds a number that is not finite (BadInput)."""
    if len(labels[0]) == 0:
        raise BadInput(f"the {name} split is empty; generate more trajectories (expert.trajectories)")
    for array, what in zip(labels, ("pose", "velocity"), strict=True):
        bad = ~np.isfinite(array).all(-1)
        if bad.any():
            raise BadInput(f"the {name} split has a {what} that is not finite, first in sample {int(bad.argmax())}")


def _prepare(
    policy: Policy,
    training: Labels,
    validation: Labels,
    settings: TrainingSettings,
    seed: int,
    initial: PolicyParameters | None,
) -> tuple:
    """Initial state, key of the orders, and both splits on the device."""
    init_key, order_key = jax.random.split(jax.random.key(seed))
    samples, held_out = encode_samples(policy, *training), encode_samples(policy, *validation)
    if initial is None:
        random = policy.init(init_key, settings.initialisation)
        parameters = policy.fit(random, np.asarray(samples.encoding.features))
    else:
        parameters = jax.tree.map(jnp.array, initial)  # a copy: an epoch consumes its state
    total = steps_per_epoch(len(training[0]), settings.batch_size) * settings.epochs
    optimizer = make_optimizer(settings, total).init(parameters.network)
    return TrainState(parameters, optimizer, jnp.int32(0)), order_key, samples, held_out


def _row(
    compiled: CompiledTraining, state: TrainState, losses: np.ndarray, held_out: Any, number: int, steps: int
) -> dict[str, Any]:
    """The epoch's row of metrics.jsonl; train_mse is the mean of its batches, each before its step."""
    if not np.isfinite(losses).all():
        bad = number * steps + int(np.argmin(np.isfinite(losses))) + 1
        raise BadInput(
            f"training diverged: the loss at step {bad} (epoch {number + 1}) is not finite; "
            'lower training.learning_rate, or set training.initialisation = "torch_uniform" '
            'or training.optimizer = "adam"'
        )
    validation = float(compiled.validation_error(state.parameters, held_out))
    if not np.isfinite(validation):
        raise BadInput(
            f"training diverged: the validation error after epoch {number + 1} is not finite; "
            "lower training.learning_rate"
        )
    return {
        "epoch": number + 1,
        "step": (number + 1) * steps,
        "train_mse": float(losses.mean(dtype=np.float64)),
        "validation_mse": validation,
    }
