"""The training stage: from a dataset to a policy, its errors, and how a kinematic robot fares with it."""

import pathlib
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax import plugins
from agile_jax.dataset import Dataset, labels_to, load, split_mask
from agile_jax.engine import open_engine
from agile_jax.experiment import Experiment
from agile_jax.files import write_json
from agile_jax.policy.kinds import make_policy
from agile_jax.policy.network import parameter_count
from agile_jax.policy.policy import Policy, TrainedPolicy
from agile_jax.progress import Progress, silent
from agile_jax.scene import POSE_SIZE, make_scene
from agile_jax.single_precision import in_single_precision
from agile_jax.store.artefact import EPOCHS, covered, key
from agile_jax.store.npz import write_npz
from agile_jax.store.parts import OpenEngine
from agile_jax.training.aggregation import Aggregation, Rounds, fit_rounds
from agile_jax.training.checkpoint import Keeping
from agile_jax.training.epochs import error_on, of_seed
from agile_jax.training.fit import FitProblem, Fitted
from agile_jax.training.kinematic_test.held_out import KinematicTest
from agile_jax.training.noise_floor import noise_floor
from agile_jax.training.samples import (
    Samples,
    Units,
    check_samples,
    make_units,
    policy_samples,
    trajectory_samples,
)

SHOWN_ERRORS = 20_000
FOLLOW_MARGIN = 4.0  # seconds beyond twice the longest label
VELOCITIES = {"label_kind": "velocity"}  # what errors are of, whatever is learned
INLINE = partial(open_engine, "inline")


class _Task(NamedTuple):
    """What a training is made of."""

    policy: Policy
    dataset: Dataset  # the labels to the scene's target
    units: Units
    test: Samples  # velocities or accelerations, in SI units
    kinematic: KinematicTest
    problem: FitProblem
    aggregation: Aggregation


def train(
    experiment: Experiment, run_dir: pathlib.Path, engine: OpenEngine = INLINE, progress: Progress = silent
) -> dict[str, object]:
    """Train the policy, or go on training it, and write metrics.jsonl, checkpoints/, finished.json, tensorboard/,
    kinematic_test.npz, test_errors.npz and summary.json in `training/` of the run directory.

    The `field_*` entries of the summary are the kinematic test (kinematic_test/held_out.py).

    Args:
        experiment: all settings.
        run_dir: holds `dataset/`.
        engine: opens the work engine for the expert's answers; this process answers when not given.
        progress: is told of every epoch.

    Returns:
        The summary.

    Raises:
        BadInput: no label leads to the scene's target; and see `fit_policy`.
        TasksFailedError: a worker failed for good.
    """
    return train_on(load(run_dir / "dataset"), experiment, run_dir / "training", engine, progress)


@in_single_precision
def train_on(
    dataset: Dataset,
    experiment: Experiment,
    directory: pathlib.Path,
    engine: OpenEngine = INLINE,
    progress: Progress = silent,
) -> dict[str, object]:
    """The stage on a dataset that is loaded already; see `train`.

    Args:
        dataset: verified trajectories; those to the scene's target are used.
        experiment, engine, progress: see `train`.
        directory: of the stage.
    """
    task = _task(dataset, experiment, engine)
    check_samples(task.test, "test")
    rounds = fit_rounds(task.problem, task.aggregation, Keeping(directory, identity(dataset, experiment)), progress)
    trained = rounds.fitted.policy
    progress("noise floor", 0, 0)
    _save_test_errors(trained, task.test, directory / "test_errors.npz")
    summary = {
        **_errors(task, experiment, rounds.fitted),
        **_account(rounds, experiment.seed),
        **task.kinematic.run(trained.parameters, directory, engine, progress),
    }
    write_json(directory / "summary.json", summary)
    return summary


def fit_dataset(
    dataset: Dataset,
    experiment: Experiment,
    directory: pathlib.Path | None = None,
    engine: OpenEngine = INLINE,
    progress: Progress = silent,
) -> Fitted:
    """Train a policy on a dataset: all rounds, without the errors and the test after them.

    Args:
        dataset: verified trajectories; those to the scene's target are used.
        experiment: all settings.
        directory: for checkpoints and metrics; nothing is kept when None, and the numbers are the same.
        engine: opens the work engine for the expert's answers, if there are rounds of aggregation.
        progress: is told of every epoch.

    Returns:
        The trained policy and its learning curve.

    Raises:
        BadInput: no label leads to the scene's target; and see `fit_policy`.
    """
    task = _task(dataset, experiment, engine)
    keeping = None if directory is None else Keeping(directory, identity(dataset, experiment))
    return fit_rounds(task.problem, task.aggregation, keeping, progress).fitted


def identity(dataset: Dataset, experiment: Experiment) -> dict[str, object]:
    """What a training's checkpoints depend on: the key, and the settings and inputs that tell differences apart."""
    settings = experiment.model_dump(mode="json")
    inputs = {"labels": dataset.dataset_hash}
    foreign = {name: digest for name, digest in plugins.digests(settings).items() if name in EPOCHS.foreign}
    named = key(EPOCHS, settings, inputs, foreign)
    return {**covered(EPOCHS, settings), "inputs": inputs, "plugins": foreign, "key": named}


@in_single_precision
def _task(dataset: Dataset, experiment: Experiment, engine: OpenEngine) -> _Task:
    """Samples, units and tests of a training."""
    scene, expert, reading = make_scene(experiment.scene), experiment.expert, experiment.dataset
    dataset = labels_to(dataset, scene.target)
    policy = make_policy(scene, expert.limits, experiment.policy)
    units = make_units(dataset, reading, experiment.training, expert.limits.velocity)
    training, validation = (
        units.outputs(policy_samples(policy, dataset, split, reading)) for split in ("train", "validation")
    )
    test = policy_samples(policy, dataset, "test", reading.model_copy(update=VELOCITIES))
    duration = float(2 * dataset.durations.max() + FOLLOW_MARGIN)
    kinematic = KinematicTest(policy, experiment.scene, expert, experiment.kinematic_test, experiment.seed)
    problem = FitProblem(
        policy,
        training,
        validation,
        experiment.training,
        experiment.seed,
        units.output,
        test=kinematic.intermediate(duration),
    )
    aggregation = Aggregation(kinematic, experiment.aggregation, duration, engine)
    return _Task(policy, dataset, units, test, kinematic, problem, aggregation)


def _errors(task: _Task, experiment: Experiment, fitted: Fitted) -> dict[str, object]:
    """The errors and noise floors of the summary."""
    policy, parameters, reading = task.policy, fitted.parameters, experiment.dataset
    held_out = ~split_mask(task.dataset, "train", reading)
    velocities = trajectory_samples(policy, task.dataset, reading.model_copy(update=VELOCITIES))
    floor = noise_floor(policy, parameters, velocities, held_out)
    test_mse = error_on(policy, parameters, task.test)
    found: dict[str, object] = {
        "train_mse": fitted.train_mse,
        "validation_mse": float(fitted.validation_mse[fitted.seed - experiment.seed]),
        "test_mse": test_mse,
        "noise_floor_mse": floor.floor if floor else None,
        "noise_floor_share": floor.share if floor else None,
        "test_mse_over_noise_floor": test_mse / floor.floor if floor and floor.floor > 0 else None,
        "label_variance": float(np.var(task.test.outputs, axis=0).mean()),
    }
    if experiment.policy.kind == "plain":
        own = task.units.outputs(policy_samples(policy, task.dataset, "test", reading))
        trajectories = task.units.outputs(trajectory_samples(policy, task.dataset, reading))
        floor = noise_floor(policy, parameters, trajectories, held_out, task.units.output)
        found["test_mse_own_units"] = error_on(policy, parameters, own, task.units.output)
        found["noise_floor_mse_own_units"] = floor.floor if floor else None
    if experiment.training.seeds > 1:
        each = (of_seed(fitted.by_seed, number) for number in range(experiment.training.seeds))
        seeds = [error_on(policy, one, task.test) for one in each]
        found |= {"test_mse_seeds_min": min(seeds), "test_mse_seeds_max": max(seeds)}
    return found


def _account(rounds: Rounds, seed: int) -> Mapping[str, object]:
    """What the summary says of the work."""
    fitted, device = rounds.fitted, jax.devices()[0]
    return {
        "seconds": rounds.seconds,
        "compile_seconds": fitted.compile_seconds,
        "epochs": rounds.epochs,
        "kept_epoch": int(fitted.epochs[fitted.seed - seed]),
        "chosen_seed": fitted.seed,
        "parameters": parameter_count(fitted.parameters),
        "training_samples": rounds.samples,
        "device": f"{device.platform} ({device.device_kind})",
        "aggregation_asked": rounds.asked,
        "aggregation_answered": rounds.answered,
    }


def _save_test_errors(trained: TrainedPolicy, test: Samples, path: pathlib.Path) -> None:
    """Write poses (m, 4) and mean squared errors (m,) of at most SHOWN_ERRORS samples, spread evenly."""
    policy, parameters = trained.policy, trained.parameters
    inputs, outputs = (array[:: -(-len(test.inputs) // SHOWN_ERRORS)] for array in test)
    output = jax.jit(jax.vmap(lambda given: policy.output(parameters, policy.encode(given))))
    error = ((np.asarray(output(jnp.asarray(inputs, jnp.float32))) - outputs) ** 2).mean(-1)
    write_npz(path, {"pose": inputs[:, :POSE_SIZE], "error": error})
