"""The training stage: from a dataset to a policy, its errors, and what it does in closed loop."""

import io
import pathlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.dataset import Dataset, DatasetSettings, Split, ask, labels_to, samples, split_mask
from agile_jax.engine import Engine, open_engine
from agile_jax.expert import ExpertSettings
from agile_jax.files import write_atomic, write_json
from agile_jax.policy.kinds import make_policy
from agile_jax.policy.network import PolicyParameters, parameter_count
from agile_jax.policy.policy import Policy
from agile_jax.policy.settings import PolicySettings
from agile_jax.progress import Progress, silent
from agile_jax.scene import POSE_SIZE, SceneSettings, make_scene
from agile_jax.settings import BadInput
from agile_jax.training.aggregation import fit_rounds, make_query
from agile_jax.training.fit import Labels, check_labels, of_seed
from agile_jax.training.kinematic_test.held_out import closed_loop_test, kinematic_follower, make_watch
from agile_jax.training.noise_floor import GammaTest, gamma_test
from agile_jax.training.settings import AggregationSettings, KinematicTestSettings, TrainingSettings
from agile_jax.training.units import error_on, errors_in_own_units, make_units

OpenEngine = Callable[[], AbstractContextManager[Engine]]

SHOWN_ERRORS = 20_000
FOLLOW_MARGIN = 4.0  # seconds beyond twice the longest label


def train(
    dataset: Dataset,
    scene_settings: SceneSettings,
    expert_settings: ExpertSettings,
    policy_settings: PolicySettings,
    training_settings: TrainingSettings,
    seed: int,
    directory: pathlib.Path,
    progress: Progress = silent,
    dataset_settings: DatasetSettings | None = None,
    closed_loop_settings: KinematicTestSettings | None = None,
    dagger_settings: AggregationSettings | None = None,
    engine: OpenEngine | None = None,
) -> dict[str, Any]:
    """Train the policy, or go on training it, and write metrics.jsonl, checkpoints/, tensorboard/, closed_loop.npz and
    summary.json in `directory`.

    The `field_*` entries of the summary are the kinematic closed loop from unseen starts (held_out.py).

    Args:
        dataset: verified trajectories; those to the scene's target are used.
        scene_settings: of the labels.
        expert_settings: bounds of the labels.
        policy_settings, training_settings: what to train, and how.
        seed: of the initial parameters and the order of the samples.
        directory: of the stage.
        progress: is told of every epoch.
        dataset_settings: split and choice of samples; the defaults when not given.
        closed_loop_settings, dagger_settings: of the closed loop, and of the rounds; the defaults when not given.
        engine: opens the work engine for the expert's answers; this process answers when not given.

    Returns:
        The summary.

    Raises:
        BadInput: no label leads to the scene's target; and see `fit_policy`.
        TasksFailedError: a worker failed for good.
    """
    dataset_settings = dataset_settings or DatasetSettings()
    closed_loop, dagger = closed_loop_settings or KinematicTestSettings(), dagger_settings or AggregationSettings()
    engine = engine or partial(open_engine, "inline")
    scene = make_scene(scene_settings)
    dataset = labels_to(dataset, scene.target)
    policy = make_policy(scene, expert_settings.limits, policy_settings)
    training, validation = (
        policy_samples(policy, dataset, split, dataset_settings) for split in ("train", "validation")
    )
    test = policy_samples(policy, dataset, "test", dataset_settings.model_copy(update={"label_kind": "velocity"}))
    check_labels(test, "test")
    units = make_units(dataset, dataset_settings, policy_settings, training_settings, expert_settings.limits.velocity)
    training, validation = ((poses, targets / units.interval) for poses, targets in (training, validation))
    identity = {
        "dataset_hash": dataset.dataset_hash,
        "dataset": dataset_settings.model_dump(mode="json"),
        "policy": policy_settings.model_dump(mode="json"),
        "closed_loop": closed_loop.model_dump(mode="json", exclude={"starts"}),
        "dagger": dagger.model_dump(mode="json"),
        "velocity_limit": list(expert_settings.velocity),
        "acceleration_limit": list(expert_settings.acceleration),
        "scene": {name: np.asarray(array).tolist() for name, array in scene._asdict().items()},
    }
    duration = float(2 * dataset.durations.max() + FOLLOW_MARGIN)
    where = (scene_settings, expert_settings)
    watch = None
    if closed_loop.every:
        watch = (closed_loop.every, make_watch(policy, *where, closed_loop, seed, duration))
    follower = kinematic_follower(policy, *where, closed_loop, duration)
    rounds = fit_rounds(
        policy,
        training,
        validation,
        training_settings,
        dagger,
        identity,
        seed,
        directory,
        make_query(follower, *where, dagger, seed, closed_loop.dt, duration),
        lambda poses, folder: ask(*where, poses, engine, folder, progress),
        progress,
        watch,
        units.output,
    )
    fitted, parameters = rounds.fitted, rounds.fitted.parameters
    progress("noise floor", 0, 0)
    floor = dataset_noise_floor(policy, parameters, dataset, dataset_settings)
    test_mse = error_on(policy, parameters, test)
    save_test_errors(policy, parameters, test, directory / "test_errors.npz")
    summary = {
        "train_mse": fitted.train_mse,
        "validation_mse": float(fitted.validation_mse[fitted.seed - seed]),
        "test_mse": test_mse,
        "noise_floor_mse": floor.floor if floor else None,
        "noise_floor_share": floor.share if floor else None,
        "test_mse_over_noise_floor": test_mse / floor.floor if floor and floor.floor > 0 else None,
        "label_variance": float(np.var(test[1], axis=0).mean()),
        "seconds": rounds.seconds,
        "compile_seconds": fitted.compile_seconds,
        "epochs": rounds.epochs,
        "kept_epoch": int(fitted.epochs[fitted.seed - seed]),
        "chosen_seed": fitted.seed,
        "parameters": parameter_count(parameters),
        "training_samples": rounds.samples,
        "device": f"{jax.devices()[0].platform} ({jax.devices()[0].device_kind})",
        "dagger_asked": rounds.asked,
        "dagger_answered": rounds.answered,
        **closed_loop_test(policy, parameters, *where, closed_loop, seed, directory, engine, progress),
    }
    if policy_settings.kind == "plain":
        summary |= errors_in_own_units(policy, parameters, dataset, dataset_settings, units)
    if training_settings.seeds > 1:
        each = (of_seed(fitted.by_seed, number) for number in range(training_settings.seeds))
        seeds = [error_on(policy, one, test) for one in each]
        summary |= {"test_mse_seeds_min": min(seeds), "test_mse_seeds_max": max(seeds)}
    write_json(directory / "summary.json", summary)
    return summary


def save_test_errors(policy: Policy, parameters: PolicyParameters, test: Labels, path: pathlib.Path) -> None:
    """Write poses (m, 4) and mean squared errors (m,) of at most SHOWN_ERRORS samples, spread evenly."""
    inputs, wanted = (array[:: -(-len(test[0]) // SHOWN_ERRORS)] for array in test)
    found = jax.jit(jax.vmap(lambda given: policy.output(parameters, policy.encode(given))))(
        jnp.asarray(inputs, jnp.float32)
    )
    buffer = io.BytesIO()
    error = ((np.asarray(found) - wanted) ** 2).mean(-1)
    np.savez(buffer, allow_pickle=False, pose=inputs[:, :POSE_SIZE], error=error)
    write_atomic(path, buffer.getvalue())


def policy_samples(policy: Policy, dataset: Dataset, split: Split, settings: DatasetSettings) -> Labels:
    """What a policy learns of a split: velocities of poses, or accelerations of states.

    Raises:
        BadInput: another reading of the labels than a feedback law has.
    """
    if policy.learns == "velocity":
        return samples(dataset, split, settings)
    if settings.split_by != "trajectory" or settings.label_kind != "velocity":
        raise BadInput(
            'dataset.split_by = "sample" and dataset.label_kind = "displacement" are for policies of velocities'
        )
    chosen = split_mask(dataset, split, settings)
    count = min(dataset.controls.shape[1], dataset.states.shape[1])  # piecewise constant: none after the last node
    states, controls = dataset.states[chosen][:, :count], dataset.controls[chosen][:, :count]
    keep = np.ones(states.shape[:2], bool)
    if settings.samples == "without_start":
        keep = dataset.times[chosen][:, :count] >= settings.start_seconds
    return states[keep], controls[keep]


def dataset_noise_floor(
    policy: Policy, parameters: PolicyParameters, dataset: Dataset, settings: DatasetSettings
) -> GammaTest | None:
    """The noise floor of the samples that are trained on; None with fewer than three trajectories.

    The lesser of two estimates, both of which err upwards where trajectories are far apart: over all trajectories with
    the designed part subtracted, and over the held-out ones with the trained policy subtracted (on those it was trained
    on, it may have learned the noise).
    """
    count = dataset.states.shape[1]
    inputs, wanted, times = dataset.states[..., :POSE_SIZE], dataset.states[..., POSE_SIZE:], dataset.times
    if policy.learns == "acceleration":
        count = min(count, dataset.controls.shape[1])
        inputs, wanted = dataset.states, dataset.controls
    first = 0
    if settings.samples == "without_start":  # trajectories must keep one length: those samples of the shortest rest
        first = min(int((times < settings.start_seconds).sum(1).max()), count - 1)
    inputs, wanted = inputs[:, first:count], wanted[:, first:count]
    held_out = ~split_mask(dataset, "train", settings)
    designed = jax.vmap(jax.vmap(lambda given: policy.encode(given).base))
    trained = jax.vmap(jax.vmap(lambda given: policy.output(parameters, policy.encode(given))))
    found = []
    for chosen, known in ((np.ones(len(held_out), bool), designed), (held_out, trained)):
        if chosen.sum() >= 3:
            given = inputs[chosen]
            rest = wanted[chosen] - np.asarray(jax.jit(known)(jnp.asarray(given, jnp.float32)))
            found.append(gamma_test(given, rest))
    return min(found, default=None)
