"""One expert, several targets; and which way it turns."""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, check_target, make_expert, minimum_time, rejection, verify
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.settings import BadInput

SETTINGS = ExpertSettings(nodes=40)
START = np.array([0.0, 0.1, 0.27, 0.1])


@pytest.mark.parametrize("dimensions", ["3d", "2d"])
def test_an_expert_with_a_target_is_the_expert_of_that_target(scene, dimensions):
    settings = SETTINGS.model_copy(update={"dimensions": dimensions})
    one = make_expert(scene, settings)
    for target in ([2.8, 1.0, 0.3, 0.4], [0.2, -1.5, 0.2, -1.0]):
        other = make_expert(scene._replace(target=np.array(target)), settings)
        for condition in ("rest", "free"):
            a, b = one.solve(START, condition, target=target), other.solve(START, condition)
            assert a.status == "solved", a.cause
            np.testing.assert_array_equal(a.trajectory.states, b.trajectory.states)
            assert (a.duration, a.lower_bound, a.branch) == (b.duration, b.lower_bound, b.branch)
    np.testing.assert_array_equal(
        one.solve(START).trajectory.states, make_expert(scene, settings).solve(START).trajectory.states
    )


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ([1.5, 0.0, 0.28, 0.0], r"goal = \[1.5, 0.0, 0.28, 0.0\] puts the torso inside obstacle 0"),
        ([2.04, 0.0, 0.28, 0.0], "0.0100 m from obstacle 0"),
        ([9.0, 0.0, 0.28, 0.0], r"goal x = 9 m is outside its bounds \[-1.5, 4.5\] m"),
        ([0.0, 0.0, 0.28, 90.0], r"goal yaw = 90 is more than a full turn \[rad\]; 90 degrees are 1\.571"),
        ([9.0, -4.0, 9.0, 0.0], r"goal x = 9 m .*\ngoal y = -4 m .*\ngoal z = 9 m"),
        ([0.0, 0.0, np.nan, 0.0], "finite"),
        ([0.0, 0.0, 0.28], "4 finite numbers"),
    ],
)
def test_bad_targets_are_refused_and_have_no_solution(scene, target, words):
    with pytest.raises(BadInput, match=words):
        check_target(scene, SETTINGS, np.array(target), "goal")
    if target == [1.5, 0.0, 0.28, 0.0]:
        assert make_expert(scene, SETTINGS).solve(START, target=target).status == "failed"
    check_target(scene, SETTINGS)


BESIDE = {"kind": "box", "position": [1.5, 1.4, 0.2], "size": [0.4, 0.4, 0.4], "yaw": 0.4}


@pytest.mark.parametrize("obstacles", [[], [BESIDE]])
@pytest.mark.parametrize(
    ("start", "target"), [(3.0, -3.0), (-3.0, 3.0), (0.5, 2.0), (-3.1, 0.2), (3.1, -0.2), (3.3, 3.2), (0.5, 3.5)]
)
def test_it_turns_the_shorter_way_where_the_bounds_hold_a_circle(obstacles, start, target):
    scene = make_scene(SceneSettings(obstacles=obstacles, target=(0.3, 0.0, 0.28, target)))
    pose = np.array([0.0, 0.0, 0.28, start])
    solution = make_expert(scene, SETTINGS).solve(pose)
    assert solution.status == "solved", solution.cause
    turn = solution.trajectory.states[-1, 3] - start
    shorter = np.arctan2(np.sin(target - start), np.cos(target - start))
    assert turn == pytest.approx(shorter, abs=1e-6)
    analytic = minimum_time(np.array([0.3, shorter]), np.array([1.0, 1.0]), np.array([1.5, 3.0])).max()
    assert solution.duration == pytest.approx(float(analytic), rel=1e-3)
    assert solution.lower_bound == pytest.approx(float(analytic))
    assert rejection(verify(scene, SETTINGS, solution.trajectory, pose)) is None
    # The check is of the angle, not of its number: half a turn off is refused.
    wrong = solution.trajectory._replace(states=solution.trajectory.states + np.eye(8)[3] * np.pi)
    assert rejection(verify(scene, SETTINGS, wrong, pose + np.eye(4)[3] * np.pi)) is not None


def test_narrower_bounds_of_yaw_are_walls():
    world = {"lower": (-1.5, -3.0, 0.155, -3.1), "upper": (4.5, 3.0, 0.32, 3.1)}
    scene = make_scene(SceneSettings(target=(0.3, 0.0, 0.28, -3.0), **world))
    solution = make_expert(scene, SETTINGS).solve([0.0, 0.0, 0.28, 3.0])
    assert solution.trajectory.states[-1, 3] == pytest.approx(-3.0)
    assert solution.duration == pytest.approx(float(minimum_time(6.0, 1.0, 3.0)), rel=1e-3)
