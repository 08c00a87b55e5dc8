"""The feedback law: designed at the target, bounded everywhere, and trained on the expert's accelerations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from synthetic import ACCELERATION, LIMITS, SMALL, TARGET, VELOCITY, empty_scene, follow, table_scene
from test_stage import SETTINGS, run, straight_lines

from agile_jax.dataset import DatasetSettings, split_mask
from agile_jax.policy import make_policy
from agile_jax.policy.velocity_tracker import track
from agile_jax.training import KinematicTestSettings
from agile_jax.training.kinematic_test.follow import ARRIVED
from agile_jax.training.samples import policy_samples

FEEDBACK = SMALL.model_copy(update={"kind": "feedback"})
DT = 0.02


def law(scene, size):
    policy = make_policy(scene, LIMITS, FEEDBACK)
    parameters = policy.init(jax.random.key(0))
    return policy, parameters._replace(network=jax.tree.map(lambda leaf: size * leaf, parameters.network))


def test_without_a_network_it_brakes_at_the_target_like_the_braking_law():
    policy, parameters = law(empty_scene(), 0.0)
    starts = np.random.default_rng(0).uniform([-1, -1.5, 0.16, -1], [2.5, 1.5, 0.31, 1], (50, 4))
    result = follow(policy, parameters, empty_scene(), starts, DT, ACCELERATION / 0.92, 12.0)
    assert (result.outcome == ARRIVED).all()
    assert result.final_error.max() < 1e-3


def test_near_the_target_it_comes_to_rest_whatever_the_network_says():
    policy, parameters = law(empty_scene(), 5.0)
    starts = TARGET + np.random.default_rng(0).uniform(-1, 1, (50, 4)) * 1e-3
    result = follow(policy, parameters, empty_scene(), starts, DT, ACCELERATION / 0.92, 6.0)
    assert (result.outcome == ARRIVED).all()
    assert result.final_error.max() < 1e-3


def test_its_command_is_within_the_bounds_and_what_a_tracker_can_follow():
    scene = table_scene()
    policy, parameters = law(scene, 5.0)
    generator = np.random.default_rng(0)
    poses = generator.uniform(-2, 2, (500, 4))
    # Far from the table and from the bounds, where the filter has nothing to say.
    poses[:, :3] = generator.uniform([-0.8, -2.0, 0.235], [0.2, 2.0, 0.245], (500, 3))
    velocities = generator.uniform(-1, 1, (500, 4)) * VELOCITY * [1, 1, 0.1, 1]
    command = jax.jit(jax.vmap(policy.command, (None, 0, 0, None)))
    wanted = np.asarray(command(parameters, poses, velocities, DT))
    assert (np.abs(wanted) <= VELOCITY * (1 + 1e-5)).all()
    inside = (np.abs(wanted) < 0.95 * VELOCITY).all(-1)
    assert (np.abs(wanted - velocities)[inside] <= ACCELERATION * DT * 1.001).all()
    followed = jax.vmap(lambda w, v: track(w, v, jnp.asarray(ACCELERATION / 0.92), DT))(
        wanted[inside], velocities[inside]
    )
    np.testing.assert_allclose(followed, wanted[inside], atol=1e-6)


@pytest.mark.parametrize("settings", [DatasetSettings(), DatasetSettings(samples="without_start", start_seconds=0.2)])
def test_it_learns_the_accelerations_of_the_states(settings):
    dataset = straight_lines()
    policy, _ = law(empty_scene(), 1.0)
    states, accelerations = policy_samples(policy, dataset, "train", settings)
    assert states.shape == (len(states), 8)
    chosen = split_mask(dataset, "train", settings)
    assert len(states) == (dataset.times[chosen][:, :-1] >= (0.2 if settings.samples != "all" else 0.0)).sum()
    # Rest to rest: speeding up where the velocity can still grow, else braking by v^2 / 2 d.
    error, velocity = states[:, :4] - TARGET, states[:, 4:]
    braking = np.sum(accelerations * velocity, -1) < 0
    distance, speed = np.linalg.norm(error, axis=-1), np.linalg.norm(velocity, axis=-1)
    size = np.linalg.norm(accelerations, axis=-1)
    np.testing.assert_allclose(speed[braking] ** 2, 2 * size[braking] * distance[braking], rtol=1e-6, atol=1e-9)


def test_training_stage_trains_it(tmp_path):
    loops = KinematicTestSettings(starts=8, every=3, watched_starts=8)
    settings = SETTINGS.model_copy(update={"epochs": 30})
    summary = run(straight_lines(), tmp_path, policy=FEEDBACK, training=settings, kinematic_test=loops)
    assert summary["test_mse"] < 0.7 * summary["label_variance"]
    assert summary["noise_floor_mse"] is not None
    assert summary["field_collision_rate"] == 0
