"""Labels of known fields, without the expert."""

import pathlib
import sys

import numpy as np

from agile_jax.expert import MotionLimits
from agile_jax.policy import PolicySettings, make_policy
from agile_jax.progress import silent
from agile_jax.scene import Scene, SceneSettings, TableSettings, make_scene
from agile_jax.training import FitProblem, Followed, Keeping, Samples, TrainingSettings, fit_policy, make_follower

VELOCITY = np.array([0.8, 0.5, 0.3, 1.0])
ACCELERATION = np.array([1.5, 1.5, 1.0, 3.0])
LIMITS = MotionLimits(VELOCITY, ACCELERATION)
TARGET = np.array([3.0, 0.0, 0.28, 0.0])
SMALL = PolicySettings(hidden_layers=(16, 16))
BRIEF = TrainingSettings(batch_size=64, epochs=8, checkpoint_every=2, learning_rate=1e-2)


def follow(policy, parameters, scene, starts, dt=0.02, acceleration_limit=None, duration=15.0) -> Followed:
    """Follow a policy from rest at each start [m, rad], for `duration` [s] at most."""
    follower = make_follower(policy, scene, duration, dt, acceleration_limit)
    return follower(parameters, starts, np.full(len(starts), duration))


def empty_scene() -> Scene:
    return make_scene(SceneSettings())


def table_scene() -> Scene:
    return make_scene(
        SceneSettings(obstacles=(TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25),))
    )


def smooth_samples(count: int, seed: int = 0) -> Samples:
    """Poses in bounds and a smooth field on them."""
    generator = np.random.default_rng(seed)
    poses = TARGET + generator.uniform(-1, 1, (count, 4)) * [1.5, 1.0, 0.04, 0.3]
    velocities = 0.5 * np.tanh(TARGET - poses) + 0.1 * np.sin(3 * poses[:, [1, 0, 3, 2]])
    return Samples(poses, velocities)


def fit(policy, training, validation, settings, seed, directory=None, progress=silent, data="synthetic", **more):
    """Kept, if at all, under an identity that tells data, settings and seed."""
    without_effect = {"checkpoint_every", "keep", "devices"}
    identity = {"data": data, "training": settings.model_dump(mode="json", exclude=without_effect), "seed": seed}
    keeping = Keeping(directory, identity) if directory else None
    return fit_policy(FitProblem(policy, training, validation, settings, seed, **more), keeping, progress)


def train_small(directory: pathlib.Path, progress=silent):
    policy = make_policy(table_scene(), LIMITS, SMALL)
    labels = smooth_samples(500), smooth_samples(100, 1)
    return policy, fit(policy, *labels, BRIEF, 3, directory, progress)


if __name__ == "__main__":  # the process that test_resumption kills: says when an epoch is done
    train_small(pathlib.Path(sys.argv[1]), lambda work, done, total, note="": print(done, flush=True))
