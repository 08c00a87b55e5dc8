"""The scene: clearance against sampled bodies and JAX, start counts, and what settings refuse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

from agile_jax.scene import SceneSettings, arrival_time, clearance, make_scene, obstacle_clearances, sample_starts
from agile_jax.settings import BadInput

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
BOX = {"kind": "box", "position": [0.4, 0.9, 0.1], "size": [0.3, 0.4, 0.2], "yaw": 0.7}


@pytest.fixture(scope="module")
def scene():
    return make_scene(SceneSettings(obstacles=[TABLE, BOX]))


def box_surface(center, half, yaw, n=25):
    """Points on the surface of a box, shape (m, 3)."""
    t = np.linspace(-1, 1, n)
    a, b = (x.ravel() for x in np.meshgrid(t, t))
    one = np.ones_like(a)
    faces = [np.stack(c, -1) for s in (-1, 1) for c in ((s * one, a, b), (a, s * one, b), (a, b, s * one))]
    c, s = np.cos(yaw), np.sin(yaw)
    return center + (np.concatenate(faces) * half) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def box_distance(points, center, half, yaw):
    """Exact distance of points to a solid box: a second, simpler definition."""
    c, s = np.cos(yaw), np.sin(yaw)
    local = (points - center) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return np.linalg.norm(np.maximum(np.abs(local) - half, 0), axis=-1)


def test_clearance_is_that_of_sampled_surfaces(scene):
    generator = np.random.default_rng(0)
    poses = generator.uniform([-0.5, -1.5, 0.1, -3], [2.5, 1.5, 0.4, 3], (150, 4))
    ours = obstacle_clearances(scene, poses)
    step = 2 * scene.torso_half_size.max() / 24
    for pose, row in zip(poses, ours, strict=True):
        for i, distance in enumerate(row):
            obstacle = (scene.obstacle_centers[i], scene.obstacle_half_sizes[i], scene.obstacle_yaws[i])
            top = pose[2] + scene.torso_half_size[2]  # down to the floor, on which the legs stand
            torso = (np.append(pose[:2], top / 2), np.append(scene.torso_half_size[:2], top / 2), pose[3])
            sampled = min(
                box_distance(box_surface(*torso), *obstacle).min(), box_distance(box_surface(*obstacle), *torso).min()
            )
            if distance > 0:
                assert distance - 1e-9 <= sampled <= distance + step
            else:
                assert sampled <= step


def test_jax_agrees(scene):
    poses = np.random.default_rng(1).uniform([-0.5, -1.5, 0.1, -3], [2.5, 1.5, 0.4, 3], (300, 4))
    compiled = jax.jit(lambda p: clearance(scene, p, jnp))(poses)
    np.testing.assert_allclose(compiled, clearance(scene, poses), atol=3e-6)


def test_clearance_under_and_before_the_table():
    scene = make_scene(SceneSettings(obstacles=[TABLE]))
    half = scene.torso_half_size
    assert clearance(scene, np.array([1.5, 0, 0.15, 0])) == pytest.approx(0.25 - 0.15 - half[2])
    assert clearance(scene, np.array([0.5, 0, 0.3, 0])) == pytest.approx(1.25 - 0.5 - half[0])
    assert clearance(scene, np.array([0.5, 0, 0.3, np.pi / 2])) == pytest.approx(1.25 - 0.5 - half[1])
    assert clearance(scene, np.array([1.5, 0, 0.27, 0])) < 0
    assert np.isinf(clearance(make_scene(SceneSettings()), np.zeros((3, 4)))).all()


def test_starts_are_counted_free_and_nested():
    scene = make_scene(SceneSettings(obstacles=[TABLE]))
    mean, std = np.array([0.5, 0.066, 0.26, 0]), np.array([0.5, 0.66, 0.02, 0])
    starts = sample_starts(scene, mean, std, 2000, 0.03, (7, 0))
    assert len(starts.poses) == 2000
    assert starts.attempted == 2000 + starts.rejected_collision + starts.rejected_bounds
    assert (clearance(scene, starts.poses) >= 0.03).all()
    assert ((starts.poses >= scene.lower) & (starts.poses <= scene.upper)).all()
    # An independent draw of the same normal meets the table as often, within four standard errors.
    draws = mean + std * np.random.default_rng(0).standard_normal((100_000, 4))
    share = (clearance(scene, draws) < 0.03).mean()
    error = np.sqrt(share * (1 - share) / starts.attempted)
    assert abs(starts.rejected_collision / starts.attempted - share) < 4 * error + 1e-3
    free = draws[clearance(scene, draws) >= 0.03]
    np.testing.assert_allclose(starts.poses.mean(0), free.mean(0), atol=0.06)
    np.testing.assert_allclose(starts.poses.std(0), free.std(0), atol=0.05)
    np.testing.assert_array_equal(sample_starts(scene, mean, std, 300, 0.03, (7, 0)).poses, starts.poses[:300])


def test_hopeless_starts_are_refused():
    scene = make_scene(SceneSettings(obstacles=[TABLE]))
    with pytest.raises(BadInput, match="starts are free"):
        sample_starts(scene, np.array([1.5, 0, 0.3, 0]), np.full(4, 0.001), 1, 0.03, (0,))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"target": [2.5, 0.0, 0.28, 45.0]}, "45 degrees are 0.7854"),
        ({"obstacles": [TABLE | {"yaw": 90.0}]}, "90 degrees are 1.571"),
        ({"lower": [5.0, -3.0, 0.155, -3.2]}, r"lower = 5.0 must be below upper = 4.5 for x"),
        ({"obstacles": [TABLE | {"size": [-0.5, 1.0]}]}, "greater than 0"),
        ({"obstacles": [TABLE | {"top": 0.1}]}, "must be above underside"),
        ({"obstacles": [TABLE | {"height": 0.1}]}, "Extra inputs"),
        ({"target": [float("nan"), 0.0, 0.28, 0.0]}, "finite number"),
    ],
)
def test_contradictions_are_refused(change, words):
    with pytest.raises(ValidationError, match=words):
        SceneSettings(**({"obstacles": [TABLE]} | change))


def test_a_path_has_arrived_when_it_stays_within_the_tolerance():
    target, times = np.array([1.0, 2.0, 0.3, 3.1]), np.linspace(0.0, 1.0, 101)
    poses = np.tile(target, (101, 1))
    poses[:, 0] += 0.995 - times  # enters the circle of 0.1 m at 0.895 s
    assert arrival_time(times, poses, target) == pytest.approx(0.9)
    poses[:, 3] -= 2 * np.pi  # full turns are nothing
    assert arrival_time(times, poses, target) == pytest.approx(0.9)
    poses[95, 2] += 0.06  # leaves once more
    assert arrival_time(times, poses, target) == pytest.approx(0.96)
    poses[-1, 3] += 0.21
    assert np.isnan(arrival_time(times, poses, target))
