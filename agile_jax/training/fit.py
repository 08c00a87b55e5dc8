"""Fitting the network to samples: resumable, bit for bit.

The parameters after epoch e are a pure function of (samples, settings, seed). A killed training goes on from its
last checkpoint and ends with the same parameters, the same optimiser state and the same metrics.jsonl as one that
was not killed (on a CPU; a GPU needs XLA's deterministic kernels for that).
"""

import pathlib
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.progress import Progress, silent
from agile_jax.settings import BadInput
from agile_jax.training.checkpoint import Checkpoint, restore_checkpoint, save_checkpoint
from agile_jax.training.epochs import (
    SI,
    Samples,
    TrainState,
    compile_training,
    device_sharding,
    encode_samples,
    mean_squared_error,
    steps_per_epoch,
)
from agile_jax.training.metrics import MetricsLog
from agile_jax.training.optimizer import make_optimizer, make_schedule
from agile_jax.training.selection import chosen_seed, kept_epochs, stops, validation_errors
from agile_jax.training.settings import TrainingSettings

Watch = Callable[[PolicyParameters], dict[str, float]]
Labels = tuple[np.ndarray, np.ndarray]  # poses (m, 4) [m, rad], velocities (m, 4) [m/s, rad/s]
NO_PART_OF_THE_RESULT = {"checkpoint_every", "keep", "devices"}  # settings that may change on resumption


class Fitted(NamedTuple):
    """The outcome of a training. What leads with S is by seed."""

    parameters: PolicyParameters  # of the chosen seed
    by_seed: PolicyParameters  # (S, ...)
    seed: int  # the chosen one: that with the least validation error
    epochs: np.ndarray  # (S,) after which the parameters were kept, from 1
    train_mse: float  # over the whole split, with the parameters
    validation_mse: np.ndarray  # (S,)
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
    unit: np.ndarray = SI,
) -> Fitted:
    """Fit the policy's network, going on from the last checkpoint in `directory` when there is one.

    Args:
        policy: the field.
        training, validation: poses and velocities.
        settings: how.
        identity: JSON that describes samples and policy; with settings and seed it must equal that of the checkpoint.
        seed: of the initial parameters and of the order of the samples; the first of `settings.seeds`.
        directory: for metrics.jsonl, tensorboard/ and checkpoints/.
        progress: is told of every epoch.
        watch: every so many epochs, what it finds of the parameters (of several seeds: of the best at that time) joins
            the row of metrics.jsonl.
        initial: parameters to begin with; random ones, and the samples' normalisation, when not given.
        unit: of the network's outputs and of the loss, shape (4,) [m/s, rad/s].

    Raises:
        BadInput: empty or non-finite samples, a batch larger than the samples, too few devices, a checkpoint of other
            settings, or a loss that is not finite.
    """
    check_labels(training, "training")
    check_labels(validation, "validation")
    if settings.batch_size > len(training[0]):
        raise BadInput(
            f"training.batch_size = {settings.batch_size} is larger than the {len(training[0])} training samples; "
            "lower it or generate more trajectories"
        )
    fixed = settings.model_dump(mode="json", exclude=NO_PART_OF_THE_RESULT)
    identity = identity | {"training": fixed, "seed": seed, "unit": np.asarray(unit, float).tolist()}
    folder = directory / "checkpoints"
    state, keys, samples, held_out = _prepare(policy, training, validation, settings, seed, unit, initial)
    kept = jax.tree.map(jnp.copy, state.parameters) if settings.select == "best" else None  # an epoch eats its state
    restored = restore_checkpoint(folder, of_seed(state.parameters, 0), _saved(state, kept), identity)
    steps = steps_per_epoch(len(training[0]), settings.batch_size)
    epoch, rows, seconds = 0, [], 0.0
    if restored is not None:
        epoch, rows, seconds = restored.step, restored.metadata["rows"], restored.metadata["seconds"]
        step = jax.device_put(jnp.full(settings.seeds, epoch * steps, jnp.int32), state.step.sharding)
        state = TrainState(restored.state["parameters"], restored.state["optimizer"], step)
        kept = restored.state.get("kept")
    last = epoch if stops(validation_errors(rows), settings) else settings.epochs
    progress("fit", epoch, last, "compiling" if epoch < last else "done already")
    compiled = compile_training(policy, settings, state, samples, held_out, keys, unit) if epoch < last else None
    schedule = make_schedule(settings, steps * settings.epochs)
    with MetricsLog(directory, rows) as log:
        while compiled is not None and len(log.rows) < last:
            number = len(log.rows)
            start = time.perf_counter()
            state, losses = compiled.epoch(state, samples, keys, np.int32(number))
            row = _row(np.asarray(losses), np.asarray(compiled.validation_error(state.parameters, held_out)), number)
            row["learning_rate"] = float(schedule(row["step"] - 1))  # of the last step taken
            if watch is not None and (number + 1) % watch[0] == 0:
                row |= watch[1](of_seed(state.parameters, int(np.argmin(validation_errors([row])))))
            log.append(row)
            errors, done = validation_errors(log.rows), number + 1
            if kept is not None:
                kept = _keep(kept, state.parameters, kept_epochs(errors, settings) == done)
            seconds += time.perf_counter() - start
            if stops(errors, settings):
                last = done
            if done % settings.checkpoint_every == 0 or done == last:
                best = of_seed(state.parameters if kept is None else kept, chosen_seed(errors, settings))
                metadata = {"rows": log.rows, "seconds": seconds}
                checkpoint = Checkpoint(done, _saved(state, kept), best, metadata)
                save_checkpoint(folder, checkpoint, identity, settings.keep)
            progress("fit", done, last, f"validation error {row['validation_mse']:.2e}")
    errors = validation_errors(log.rows)
    by_seed, chosen = state.parameters if kept is None else kept, chosen_seed(errors, settings)
    parameters, epochs = of_seed(by_seed, chosen), kept_epochs(errors, settings)
    with jax.default_matmul_precision("float32"):
        train_mse = jax.jit(partial(mean_squared_error, policy))(parameters, samples)
    return Fitted(
        parameters=parameters,
        by_seed=by_seed,
        seed=seed + chosen,
        epochs=epochs,
        train_mse=float(train_mse),
        validation_mse=errors[epochs - 1, np.arange(settings.seeds)],
        seconds=seconds,
        compile_seconds=compiled.compile_seconds if compiled is not None else 0.0,
        rows=log.rows,
    )


def check_labels(labels: Labels, name: str) -> None:
    """Refuse a split that is empty or holds a number that is not finite (BadInput)."""
    if len(labels[0]) == 0:
        raise BadInput(f"the {name} split is empty; generate more trajectories (dataset.trajectories)")
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
    unit: np.ndarray,
    initial: PolicyParameters | None = None,
) -> tuple[TrainState, jax.Array, Samples, Samples]:
    """Initial states and keys of the orders, by seed, and both splits, all on the devices."""
    samples, held_out = encode_samples(policy, *training), encode_samples(policy, *validation)
    features = np.asarray(samples.encoding.features)
    total = steps_per_epoch(len(training[0]), settings.batch_size) * settings.epochs
    optimizer = make_optimizer(settings, total)
    states, keys = [], []
    for number in range(seed, seed + settings.seeds):
        init_key, order_key = jax.random.split(jax.random.key(number))
        parameters = initial
        if parameters is None:
            parameters = policy.normalise(policy.init(init_key, settings.initialisation), features)
            scale = parameters.normalization.scale * jnp.asarray(unit, jnp.float32)
            parameters = parameters._replace(normalization=parameters.normalization._replace(scale=scale))
        states.append(TrainState(parameters, optimizer.init(parameters.network), jnp.int32(0)))
        keys.append(order_key)
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
    everything = stacked, np.stack([jax.random.key_data(key) for key in keys]), samples, held_out
    # From the host: devices of other processes cannot be reached from a device of this one.
    state, raw_keys, samples, held_out = jax.device_put(
        jax.tree.map(np.asarray, everything), device_sharding(settings.devices)
    )
    return state, jax.random.wrap_key_data(raw_keys), samples, held_out


def _row(losses: np.ndarray, validation: np.ndarray, number: int) -> dict[str, Any]:
    """The epoch's row of metrics.jsonl: means over the seeds. train_mse is the mean of the batches, each before its
    step.

    Args:
        losses: shape (S, steps).
        validation: shape (S,).
        number: of the epoch, from 0.

    Raises:
        BadInput: a number is not finite.
    """
    remedy = (
        "lower training.learning_rate, warm up (training.warmup), set training.clip_norm, "
        'training.initialisation = "torch_uniform" or training.optimizer = "adam"'
    )
    seeds, steps = losses.shape
    where = "" if seeds == 1 else " of one of the seeds"
    if not np.isfinite(losses).all():
        bad = number * steps + int(np.argmin(np.isfinite(losses).all(0))) + 1
        raise BadInput(f"training diverged: the loss{where} at step {bad} (epoch {number + 1}) is not finite; {remedy}")
    if not np.isfinite(validation).all():
        raise BadInput(
            f"training diverged: the validation error{where} after step {(number + 1) * steps} (epoch {number + 1}) "
            f"is not finite; {remedy}"
        )
    means = losses.mean(1, dtype=np.float64)
    row: dict[str, Any] = {
        "epoch": number + 1,
        "step": (number + 1) * steps,
        "train_mse": float(means.mean()),
        "validation_mse": float(validation.mean(dtype=np.float64)),
    }
    if seeds > 1:
        row |= {"train_mse_by_seed": means.tolist(), "validation_mse_by_seed": validation.tolist()}
    return row


def _saved(state: TrainState, kept: PolicyParameters | None) -> dict[str, Any]:
    """All from which a training goes on; the step follows from the epoch."""
    saved = {"parameters": state.parameters, "optimizer": state.optimizer}
    return saved if kept is None else saved | {"kept": kept}


def of_seed(by_seed: PolicyParameters, number: int) -> PolicyParameters:
    """The parameters of one seed."""
    return jax.tree.map(lambda leaf: leaf[number], by_seed)


@jax.jit
def _keep(kept: PolicyParameters, new: PolicyParameters, better: jax.Array) -> PolicyParameters:
    """The new parameters where `better`, shape (S,)."""
    return jax.tree.map(lambda old, leaf: jnp.where(better.reshape(-1, *[1] * (leaf.ndim - 1)), leaf, old), kept, new)
