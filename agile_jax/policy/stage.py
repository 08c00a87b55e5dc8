"""The training stage: from a dataset to a policy, its errors, and what it does in closed loop."""

import pathlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.dataset import Dataset, DatasetSettings, labels_to, samples, split_mask
from agile_jax.expert import ExpertSettings
from agile_jax.files import write_json
from agile_jax.policy.closed_loop import ARRIVED, COLLIDED, STALLED, Followed, follow
from agile_jax.policy.epochs import encode_samples, mean_squared_error
from agile_jax.policy.field import Policy, make_policy
from agile_jax.policy.gamma_test import noise_floor
from agile_jax.policy.network import PolicyParameters, parameter_count
from agile_jax.policy.settings import PolicySettings, TrainingSettings
from agile_jax.policy.training import check_labels, fit_policy
from agile_jax.progress import Progress, silent
from agile_jax.scene import POSE_SIZE, Scene
from agile_jax.settings import BadInput

HEADROOM = 0.92  # acceleration of the labels over that of the robot that follows them
FOLLOWED_STARTS = 256  # at most
FOLLOW_MARGIN = 4.0  # seconds beyond twice the longest label


def train(
    dataset: Dataset,
    scene: Scene,
    expert_settings: ExpertSettings,
    policy_settings: PolicySettings,
    training_settings: TrainingSettings,
    seed: int,
    directory: pathlib.Path,
    progress: Progress = silent,
    dataset_settings: DatasetSettings | None = None,
) -> dict[str, Any]:
    """Train the policy, or go on training it, and write metrics.jsonl, checkpoints/, tensorboard/ and summary.json
    in `directory`.

    The `field_*` entries of the summary are the kinematic closed loop (closed_loop.py) from the starts of the test
    split, from rest, with 1 / 0.92 of the labels' acceleration.

    Args:
        dataset: verified trajectories; those to the scene's target are used.
        scene: of the labels.
        expert_settings: bounds of the labels.
        policy_settings, training_settings: what to train, and how.
        seed: of the initial parameters and the order of the samples.
        directory: of the stage.
        progress: is told of every epoch.
        dataset_settings: split and choice of samples; the defaults when not given.

    Returns:
        The summary.

    Raises:
        BadInput: no label leads to the scene's target; and see `fit_policy`.
    """
    dataset = labels_to(dataset, scene.target)
    dataset_settings = dataset_settings or DatasetSettings()
    velocity_limit, acceleration_limit = np.array(expert_settings.velocity), np.array(expert_settings.acceleration)
    policy = make_policy(scene, velocity_limit, acceleration_limit, policy_settings)
    training, validation, test = (
        samples(dataset, split, dataset_settings) for split in ("train", "validation", "test")
    )
    check_labels(test, "test")
    identity = {
        "dataset_hash": dataset.dataset_hash,
        "dataset": dataset_settings.model_dump(mode="json"),
        "policy": policy_settings.model_dump(mode="json"),
        "velocity_limit": list(expert_settings.velocity),
        "acceleration_limit": list(expert_settings.acceleration),
        "scene": {name: np.asarray(array).tolist() for name, array in scene._asdict().items()},
    }
    fitted = fit_policy(policy, training, validation, training_settings, identity, seed, directory, progress)
    progress(0, 0, "training: closed loop and noise floor")
    parameters = fitted.parameters
    held_out = split_mask(dataset, "test", dataset_settings)
    followed, ratios = _follow_test(policy, parameters, scene, dataset, held_out, acceleration_limit / HEADROOM)
    summary = {
        "train_mse": fitted.train_mse,
        "validation_mse": fitted.validation_mse,
        "test_mse": float(mean_squared_error(policy, parameters, encode_samples(policy, *test))),
        "noise_floor_mse": dataset_noise_floor(policy, parameters, dataset, dataset_settings),
        "label_variance": float(np.var(test[1], axis=0).mean()),
        "seconds": fitted.seconds,
        "compile_seconds": fitted.compile_seconds,
        "epochs": len(fitted.rows),
        "parameters": parameter_count(parameters),
        "training_samples": len(training[0]),
        "device": f"{jax.devices()[0].platform} ({jax.devices()[0].device_kind})",
        "field_starts": len(followed.outcome),
        "field_arrived_rate": followed.rate(ARRIVED),
        "field_collision_rate": followed.rate(COLLIDED),
        "field_stall_rate": followed.rate(STALLED),
        "field_time_ratio_median": float(np.median(ratios)) if len(ratios) else None,
        "field_time_ratio_p95": float(np.quantile(ratios, 0.95)) if len(ratios) else None,
        "field_min_clearance_m_p05": _finite(np.quantile(followed.min_clearance, 0.05, method="lower")),
    }
    write_json(directory / "summary.json", summary)
    return summary


def dataset_noise_floor(
    policy: Policy, parameters: PolicyParameters, dataset: Dataset, settings: DatasetSettings
) -> float | None:
    """The noise floor of the samples that are trained on; None with fewer than three trajectories.

    The lesser of two estimates, both of which err upwards where trajectories are far apart: over all trajectories with
    the braking law subtracted, and over the held-out ones with the trained field subtracted (on those it was trained
    on, the field may have learned the noise).
    """
    states, times = dataset.states, dataset.times
    if settings.samples == "without_start":  # trajectories must keep one length: those samples of the shortest rest
        first = int((times < settings.start_seconds).sum(1).max())
        states = states[:, min(first, states.shape[1] - 1) :]
    held_out = ~split_mask(dataset, "train", settings)
    law = jax.vmap(jax.vmap(lambda pose: policy.encode(pose).base))
    field = jax.vmap(jax.vmap(lambda pose: policy.field(parameters, policy.encode(pose))))
    estimates = []
    for chosen, known in ((states, law), (states[held_out], field)):
        if len(chosen) >= 3:
            poses, velocities = chosen[..., :POSE_SIZE], chosen[..., POSE_SIZE:]
            rest = velocities - np.asarray(jax.jit(known)(jnp.asarray(poses, jnp.float32)))
            estimates.append(noise_floor(poses, rest))
    return min(estimates, default=None)


def _follow_test(
    policy: Policy,
    parameters: PolicyParameters,
    scene: Scene,
    dataset: Dataset,
    held_out: np.ndarray,
    acceleration_limit: np.ndarray,
) -> tuple[Followed, np.ndarray]:
    """Closed loops from the test split's starts, and arrival time over the label's duration of those that arrived."""
    if not held_out.any():
        raise BadInput("the test split is empty; generate more trajectories (expert.trajectories)")
    starts, durations = dataset.starts[held_out][:FOLLOWED_STARTS], dataset.durations[held_out][:FOLLOWED_STARTS]
    length = float(2 * durations.max() + FOLLOW_MARGIN)
    followed = follow(policy, parameters, scene, starts, acceleration_limit=acceleration_limit, duration=length)
    # A start next to the target takes no time, and no ratio can be given.
    arrived = (followed.outcome == ARRIVED) & (durations > 1.0)
    return followed, followed.arrival_time[arrived] / durations[arrived]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
