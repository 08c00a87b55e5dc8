"""Fitting the network to samples: resumable, bit for bit.

The parameters after epoch e are a pure function of (samples, settings, seed). A killed training goes on from its
last checkpoint and ends with the same parameters, the same optimiser state and the same metrics.jsonl as one that
was not killed (on a CPU; a GPU needs XLA's deterministic kernels for that). Nothing is kept unless a folder is given,
and the numbers do not depend on that.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PyTree

from agile_jax.files import sha256
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy, TrainedPolicy
from agile_jax.progress import Progress, silent
from agile_jax.settings import BadInput
from agile_jax.single_precision import in_single_precision
from agile_jax.training.checkpoint import Checkpoint, Keeping, restore_checkpoint, save_checkpoint
from agile_jax.training.epochs import (
    CompiledTraining,
    EncodedSamples,
    TrainState,
    compile_training,
    device_sharding,
    encode_samples,
    mean_squared_error,
    of_seed,
    steps_per_epoch,
)
from agile_jax.training.finished import CHECKPOINTS, FINISHED, write_finished
from agile_jax.training.metrics import MetricsLog, Row, epoch_row
from agile_jax.training.optimizer import make_optimizer, make_schedule
from agile_jax.training.samples import SI, Samples, Unit, check_samples
from agile_jax.training.selection import chosen_seed, kept_epochs, stops, validation_errors
from agile_jax.training.settings import TrainingSettings


class IntermediateTest(NamedTuple):
    """What is asked of the parameters between epochs; its findings join the row of metrics.jsonl."""

    every: int  # epochs
    run: Callable[[PolicyParameters], dict[str, float]]


@dataclass(frozen=True, eq=False)
class FitProblem:
    """What is fitted to what, and how.

    Attributes:
        policy: whose output is fitted.
        training, validation: samples.
        settings: optimiser, epochs, batches.
        seed: of the initial parameters and of the order of the samples; the first of `settings.seeds`.
        unit: of the network's outputs and of the loss.
        initial: parameters to begin with; random ones, and the samples' normalisation, when None.
        test: between epochs (of several seeds: on the best at that time); none when None.
    """

    policy: Policy
    training: Samples
    validation: Samples
    settings: TrainingSettings
    seed: int
    unit: Unit = field(default_factory=lambda: SI)
    initial: PolicyParameters | None = None
    test: IntermediateTest | None = None

    @property
    def steps(self) -> int:
        """Steps of an epoch."""
        return steps_per_epoch(len(self.training.inputs), self.settings.batch_size)

    def check(self) -> None:
        """Refuse samples that are empty or not finite, or a batch that is larger than they are (BadInput)."""
        check_samples(self.training, "training")
        check_samples(self.validation, "validation")
        if self.settings.batch_size > len(self.training.inputs):
            raise BadInput(
                f"training.batch_size = {self.settings.batch_size} is larger than the {len(self.training.inputs)} "
                "training samples; lower it or generate more trajectories"
            )


class Fitted(NamedTuple):
    """The outcome of a training. What leads with S is by seed."""

    policy: TrainedPolicy  # of the chosen seed
    by_seed: PolicyParameters  # (S, ...)
    seed: int  # the chosen one: that with the least validation error
    epochs: Int[np.ndarray, " S"]  # after which the parameters were kept, from 1
    train_mse: float  # over the whole split, with the parameters [(m/s)^2, (rad/s)^2], as the next
    validation_mse: Float[np.ndarray, " S"]
    seconds: float  # in epochs, over all resumptions, compilation apart
    compile_seconds: float  # in this process
    rows: list[Row]  # the learning curve, as in metrics.jsonl

    @property
    def parameters(self) -> PolicyParameters:
        """Of the chosen seed."""
        return self.policy.parameters


class Prepared(NamedTuple):
    """What a training begins with, on the devices."""

    state: TrainState  # leads with the seeds
    keys: Key[Array, " S"]  # of the orders
    training: EncodedSamples
    validation: EncodedSamples


class _Position(NamedTuple):
    """How far a training has come."""

    state: TrainState
    best: PolicyParameters | None  # (S, ...) of the best epochs; None where the last ones are kept
    rows: list[Row]
    seconds: float

    def saved(self) -> PyTree:
        """All from which the training goes on; the step follows from the epoch."""
        saved = {"parameters": self.state.parameters, "optimizer": self.state.optimizer}
        return saved if self.best is None else saved | {"kept": self.best}

    def by_seed(self) -> PolicyParameters:
        """The parameters that each seed keeps, (S, ...)."""
        return self.state.parameters if self.best is None else self.best


@in_single_precision
def fit_policy(problem: FitProblem, keeping: Keeping | None = None, progress: Progress = silent) -> Fitted:
    """Fit a policy's network, in memory; or in a folder, going on from its last checkpoint when there is one.

    Args:
        problem: what is fitted to what.
        keeping: where it is kept; nowhere when None.
        progress: is told of every epoch.

    Raises:
        BadInput: unusable samples, too few devices, a checkpoint of other settings or of more epochs, or a loss that
            is not finite.
        OSError: the disk is full or cannot be written; the checkpoints before are whole.
    """
    problem.check()
    prepared = prepare(problem)
    position = _begin(problem, prepared, keeping)
    done, last, compile_seconds = len(position.rows), _last_epoch(position.rows, problem.settings), 0.0
    progress("fit", done, last, "compiling" if done < last else "done already")
    with MetricsLog(keeping.directory if keeping else None, position.rows) as log:
        if done < last:
            if keeping:
                (keeping.directory / FINISHED).unlink(missing_ok=True)
            compiled = compile_training(
                problem.policy, problem.settings, position.state, *prepared[2:], prepared.keys, problem.unit
            )
            compile_seconds = compiled.compile_seconds
            position = _train(problem, prepared, position, compiled, log, keeping, progress)
    fitted = _outcome(problem, prepared, position, compile_seconds)
    if keeping and jax.process_index() == 0:
        numbers = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(fitted.parameters))
        write_finished(keeping.directory, len(position.rows), sha256(numbers))
    return fitted


def prepare(problem: FitProblem) -> Prepared:
    """Initial states and keys of the orders, by seed, and both splits, all on the devices."""
    policy, settings = problem.policy, problem.settings
    training, validation = encode_samples(policy, problem.training), encode_samples(policy, problem.validation)
    features = np.asarray(training.encoding.features)
    optimizer = make_optimizer(settings, problem.steps * settings.epochs)
    states, keys = [], []
    for number in range(problem.seed, problem.seed + settings.seeds):
        init_key, order_key = jax.random.split(jax.random.key(number))
        parameters = problem.initial
        if parameters is None:
            parameters = policy.normalise(policy.init(init_key, settings.initialisation), features)
            scale = parameters.normalization.scale * jnp.asarray(problem.unit, jnp.float32)
            parameters = parameters._replace(normalization=parameters.normalization._replace(scale=scale))
        states.append(TrainState(parameters, optimizer.init(parameters.network), jnp.int32(0)))
        keys.append(order_key)
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *states)
    everything = stacked, np.stack([jax.random.key_data(key) for key in keys]), training, validation
    # From the host: devices of other processes cannot be reached from a device of this one.
    state, raw_keys, training, validation = jax.device_put(
        jax.tree.map(np.asarray, everything), device_sharding(settings.devices)
    )
    return Prepared(state, jax.random.wrap_key_data(raw_keys), training, validation)


def _begin(problem: FitProblem, prepared: Prepared, keeping: Keeping | None) -> _Position:
    """The beginning, or the last sound checkpoint."""
    state, settings = prepared.state, problem.settings
    best = jax.tree.map(jnp.copy, state.parameters) if settings.select == "best" else None  # an epoch eats its state
    begin = _Position(state, best, [], 0.0)
    if keeping is None:
        return begin
    folder = keeping.directory / CHECKPOINTS
    restored = restore_checkpoint(folder, of_seed(state.parameters, 0), begin.saved(), keeping.identity)
    if restored is None:
        return begin
    if restored.step > settings.epochs:
        raise BadInput(
            f"{folder} holds {restored.step} epochs, more than training.epochs = {settings.epochs}; ask for as many, "
            "or use another run directory"
        )
    step = jnp.full(settings.seeds, restored.step * problem.steps, jnp.int32)
    there = restored.state
    state = TrainState(there["parameters"], there["optimizer"], jax.device_put(step, state.step.sharding))
    return _Position(state, there.get("kept"), restored.rows, restored.seconds)


def _train(
    problem: FitProblem,
    prepared: Prepared,
    position: _Position,
    compiled: CompiledTraining,
    log: MetricsLog,
    keeping: Keeping | None,
    progress: Progress,
) -> _Position:
    """Train to the last epoch."""
    settings = problem.settings
    while len(position.rows) < _last_epoch(position.rows, settings):
        position = _epoch(problem, prepared, position, compiled)
        log.append(position.rows[-1])
        done, last = len(position.rows), _last_epoch(position.rows, settings)
        if keeping is not None and (done % settings.checkpoint_every == 0 or done == last):
            chosen = of_seed(position.by_seed(), chosen_seed(validation_errors(position.rows), settings))
            checkpoint = Checkpoint(done, position.saved(), chosen, position.rows, position.seconds)
            save_checkpoint(keeping.directory / CHECKPOINTS, checkpoint, keeping.identity, settings.keep)
        progress("fit", done, last, f"validation error {position.rows[-1]['validation_mse']:.2e}")
    return position


def _epoch(problem: FitProblem, prepared: Prepared, position: _Position, compiled: CompiledTraining) -> _Position:
    """The next epoch, its row and what each seed keeps."""
    settings, number = problem.settings, len(position.rows)
    start = time.perf_counter()
    state, losses = compiled.epoch(position.state, prepared.training, prepared.keys, number)
    validation = np.asarray(compiled.validation_error(state.parameters, prepared.validation))
    row = epoch_row(np.asarray(losses), validation, number)
    schedule = make_schedule(settings, problem.steps * settings.epochs)
    row["learning_rate"] = float(schedule((number + 1) * problem.steps - 1))  # of the last step taken
    if problem.test is not None and (number + 1) % problem.test.every == 0:
        row |= problem.test.run(of_seed(state.parameters, int(np.argmin(validation_errors([row])))))
    rows, best = [*position.rows, row], position.best
    if best is not None:
        best = _better(best, state.parameters, kept_epochs(validation_errors(rows), settings) == number + 1)
    return _Position(state, best, rows, position.seconds + time.perf_counter() - start)


def _last_epoch(rows: list[Row], settings: TrainingSettings) -> int:
    """The epoch after which the training ends, as far as is known after these."""
    return len(rows) if stops(validation_errors(rows), settings) else settings.epochs


def _outcome(problem: FitProblem, prepared: Prepared, position: _Position, compile_seconds: float) -> Fitted:
    """What a training has made."""
    settings, errors = problem.settings, validation_errors(position.rows)
    chosen, epochs = chosen_seed(errors, settings), kept_epochs(errors, settings)
    parameters = of_seed(position.by_seed(), chosen)
    with jax.default_matmul_precision("float32"):
        train_mse = jax.jit(partial(mean_squared_error, problem.policy))(parameters, prepared.training)
    return Fitted(
        policy=TrainedPolicy(problem.policy, parameters),
        by_seed=position.by_seed(),
        seed=problem.seed + chosen,
        epochs=epochs,
        train_mse=float(train_mse),
        validation_mse=errors[epochs - 1, np.arange(settings.seeds)],
        seconds=position.seconds,
        compile_seconds=compile_seconds,
        rows=position.rows,
    )


@jax.jit
def _better(best: PolicyParameters, new: PolicyParameters, better: Bool[Array, " S"]) -> PolicyParameters:
    """The new parameters of the seeds that are better."""
    return jax.tree.map(lambda old, leaf: jnp.where(better.reshape(-1, *[1] * (leaf.ndim - 1)), leaf, old), best, new)
