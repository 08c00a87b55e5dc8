"""Yaw as an angle, and the legs of tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

from agile_jax.geometry import rotation_2d
from agile_jax.scene import SceneSettings, clearance, facing, make_scene, pose_error, turns_freely, yaw_between_bounds

WALLS = {"lower": (-1.5, -3.0, 0.155, 1.0), "upper": (4.5, 3.0, 0.32, 5.0), "target": (3.0, 0.0, 0.28, 4.5)}
TABLE = {"kind": "table", "position": [1.5, 0.4], "size": [0.7, 1.1], "underside": 0.25, "yaw": 0.6}


def test_a_full_circle_of_yaw_has_no_bounds():
    scene = make_scene(SceneSettings(target=(3.0, 0.0, 0.28, -3.0)))
    assert turns_freely(scene)
    assert pose_error(scene, np.array([3.0, 0.0, 0.28, 3.0]))[3] == pytest.approx(6.0 - 2 * np.pi)
    seen = facing(scene, np.array([0.0, 0.0, 0.28, 3.0]))
    assert seen.target[3] == pytest.approx(2 * np.pi - 3.0)
    assert seen.lower[3] <= seen.target[3] <= seen.upper[3]
    assert facing(scene, np.array([0.0, 0.0, 0.28, -1.0])) is scene
    exactly = make_scene(SceneSettings(lower=(-1.5, -3.0, 0.155, -np.pi), upper=(4.5, 3.0, 0.32, np.pi)))
    assert turns_freely(exactly)
    assert turns_freely(exactly._replace(lower=exactly.lower.astype("f"), upper=exactly.upper.astype("f")))


def test_narrower_bounds_of_yaw_are_walls_and_a_measured_yaw_is_read_between_them():
    scene = make_scene(SceneSettings(**WALLS))
    assert not turns_freely(scene)
    assert facing(scene, np.array([0.0, 0.0, 0.28, 1.1])) is scene
    measured = 4.0 - 2 * np.pi  # as a quaternion gives it
    assert yaw_between_bounds(scene, measured) == pytest.approx(4.0)
    # The shorter way from 1.1 to 4.5 leads across the wall at 1.0: the error says to turn up.
    assert pose_error(scene, np.array([3.0, 0.0, 0.28, 1.1]))[3] == pytest.approx(-3.4)
    compiled = jax.jit(lambda pose: pose_error(scene, pose, jnp))(jnp.array([2.0, 0.0, 0.28, measured]))
    np.testing.assert_allclose(compiled, [-1.0, 0.0, 0.0, -0.5], atol=1e-6)


def test_legs_stand_in_the_corners_and_turn_with_the_table():
    scene = make_scene(SceneSettings(obstacles=[TABLE | {"leg_size": [0.05, 0.08], "leg_inset": 0.1}, TABLE]))
    np.testing.assert_array_equal(scene.obstacle_numbers, [0, 0, 0, 0, 0, 1])
    np.testing.assert_array_equal(scene.obstacle_yaws, 0.6)
    local = (scene.obstacle_centers[1:5, :2] - [1.5, 0.4]) @ rotation_2d(np.array(0.6))
    assert {(round(x, 9), round(y, 9)) for x, y in local} == {(x, y) for x in (-0.225, 0.225) for y in (-0.41, 0.41)}
    np.testing.assert_allclose(scene.obstacle_half_sizes[1:5], [[0.025, 0.04, 0.125]] * 4)
    np.testing.assert_allclose(scene.obstacle_centers[1:5, 2], 0.125)
    leg = np.array([*scene.obstacle_centers[1, :2], 0.16, 0.0])
    assert clearance(scene, leg) < 0
    assert clearance(make_scene(SceneSettings(obstacles=[TABLE])), leg) == pytest.approx(0.25 - 0.16 - 0.058)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"leg_inset": 0.1}, "needs a leg_size"),
        ({"leg_size": [0.35, 0.05]}, "leaves nothing between the legs along x"),
        ({"leg_size": [0.05, 0.05], "leg_inset": 0.5}, "leaves nothing between the legs"),
        ({"leg_size": [0.05, -0.05]}, "greater than 0"),
        ({"leg_size": 0.05}, "valid tuple"),
        ({"kind": "box", "leg_size": [0.05, 0.05]}, "Extra inputs|Field required"),
    ],
)
def test_impossible_legs_are_refused(change, words):
    with pytest.raises(ValidationError, match=words):
        SceneSettings(obstacles=[TABLE | change])
