"""The top speed by height: what the numbers mean, and which are refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

from agile_jax.scene import (
    CrouchSettings,
    SceneSettings,
    least_height,
    make_scene,
    speed_lines,
    top_speed,
    within_top_speed,
)

HEIGHTS, SPEEDS = (0.12, 0.14, 0.15, 0.17), (0.5, 0.8, 1.0, 1.5)
SCENE = make_scene(SceneSettings(crouch=CrouchSettings(by="hand", lowest=0.12, heights=HEIGHTS, speeds=SPEEDS)))


def test_the_top_speed_is_linear_between_its_numbers_and_goes_on_beyond():
    between = np.linspace(0.12, 0.17, 101)
    np.testing.assert_allclose(top_speed(SCENE, between), np.interp(between, HEIGHTS, SPEEDS), rtol=1e-12)
    np.testing.assert_allclose(top_speed(SCENE, np.array([0.10, 0.05, 0.19])), [0.2, 0.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(top_speed(SCENE, jnp.asarray(between), jnp), top_speed(SCENE, between), rtol=1e-5)


def test_every_line_is_a_safe_bound_and_touches():
    heights = np.linspace(0.05, 0.25, 201)
    lines = speed_lines(SCENE)
    assert len(lines) == 3
    below = lines[:, :1] + lines[:, 1:] * heights
    assert (below <= top_speed(SCENE, heights) + 1e-12).all()
    assert (np.abs(below - top_speed(SCENE, heights)).min(1) < 1e-12).all()


def test_the_least_height_is_the_inverse():
    speeds = np.linspace(0.1, 2.0, 50)
    np.testing.assert_allclose(top_speed(SCENE, least_height(SCENE, speeds)), speeds, rtol=1e-12)


def test_a_velocity_keeps_its_direction_and_is_within_the_top_speed():
    generator = np.random.default_rng(0)
    velocity, height = generator.normal(size=(300, 4)), generator.uniform(0.11, 0.2, 300)
    slow = within_top_speed(SCENE, height, velocity)
    allowed = top_speed(SCENE, height)
    assert (np.abs(slow[:, :2]) <= allowed[:, None] + 1e-12).all()
    np.testing.assert_allclose(
        slow / np.linalg.norm(slow, axis=1)[:, None], velocity / np.linalg.norm(velocity, axis=1)[:, None]
    )
    within = np.abs(velocity[:, :2]).max(1) <= allowed
    assert 0 < within.sum() < 300
    np.testing.assert_array_equal(slow[within], velocity[within])


def test_without_numbers_there_is_no_bound():
    free = make_scene(SceneSettings())
    assert top_speed(free, np.array([0.1, 0.3])).tolist() == [np.inf, np.inf]
    assert least_height(free, np.array([9.0])).tolist() == [-np.inf]
    velocity = np.array([9.0, 0.0, 0.0, 0.0])
    assert within_top_speed(free, np.array(0.1), velocity) is velocity


def test_a_lower_bound_of_zero_is_the_lowest_height_at_which_it_walks():
    assert make_scene(SceneSettings()).lower[2] == 0.155
    assert SCENE.lower[2] == 0.12
    assert make_scene(SceneSettings(lower=(-1.5, -3.0, 0.13, -3.2))).lower[2] == 0.13
    with pytest.raises(ValidationError, match=r"lower = 0.4 must be below upper = 0.32 for z"):
        SceneSettings(crouch=CrouchSettings(by="hand", lowest=0.4))


@pytest.mark.parametrize(
    ("heights", "speeds", "words"),
    [
        ([0.1, 0.2], [0.5], "equally many, none or at least two, not 2 and 1"),
        ([0.1], [0.5], "at least two, not 1 and 1"),
        ([0.2, 0.1], [0.5, 0.6], r"heights = \[0.2, 0.1\] must increase"),
        ([0.1, 0.2], [0.6, 0.5], r"speeds = \[0.6, 0.5\] must increase"),
        ([0.1, 0.2, 0.3], [0.5, 0.8, 0.9], "convex"),
    ],
)
def test_numbers_that_are_no_convex_bound_are_refused(heights, speeds, words):
    with pytest.raises(ValidationError, match=words):
        CrouchSettings(by="hand", heights=heights, speeds=speeds)
