"""The expert as a planner in the loop."""

import numpy as np
import pytest

from agile_jax.evaluation.planners import ExpertPlanner
from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import SceneSettings, TableSettings, make_scene

SCENE = make_scene(
    SceneSettings(obstacles=(TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25),))
)
SETTINGS = ExpertSettings(nodes=40)
START = np.array([0.0, 0.1, 0.28, 0.0])
LEAD = 0.05


def test_the_first_path_is_the_experts_from_rest():
    planner = ExpertPlanner(SCENE, SETTINGS, 2, None, LEAD)
    planner.begin(np.array([1]), START[None])
    expected = make_expert(SCENE, SETTINGS).solve(START, initial_velocity="rest").trajectory
    np.testing.assert_allclose(planner.paths.times[1], expected.times, atol=1e-6)
    np.testing.assert_allclose(planner.paths.poses[1], expected.states[:, :4], atol=1e-6)
    planner.advance(np.tile(START, (2, 1)), np.array([5.0, 5.0]), np.array([True, True]))
    assert len(planner.solve_times) == 1  # open loop asks once


def test_a_path_waits_for_a_robot_that_is_late_and_for_no_other():
    planner = ExpertPlanner(SCENE, SETTINGS, 3, None, LEAD)
    planner.begin(np.arange(3), np.tile(START, (3, 1)))
    times, poses = planner.paths.times[0], planner.paths.poses[0]
    begun = []
    for k in range(1, 76):  # the first robot keeps up, the second goes half as fast, the third is far ahead
        now = 0.02 * k
        where = [[np.interp(share * now, times, poses[:, i]) for i in range(4)] for share in (1.0, 0.5, 1.3)]
        planner.advance(np.array(where), np.full(3, now), np.ones(3, bool))
        begun.append(planner.paths.begun.copy())
    assert (np.array(begun)[:, [0, 2]] == 0).all()
    late = begun[-1][1]
    ahead = [np.interp(1.5 - late, times, poses[:, i]) - np.interp(0.75, times, poses[:, i]) for i in range(2)]
    assert np.hypot(*ahead) == pytest.approx(2 * LEAD, abs=0.03)
    assert (np.diff([clock[1] for clock in begun]) >= 0).all()


def test_it_plans_again_when_due_and_keeps_its_path_where_there_is_none():
    planner = ExpertPlanner(SCENE, SETTINGS, 3, 0.1, LEAD)
    planner.begin(np.arange(3), np.tile(START, (3, 1)))
    before = planner.paths
    poses = np.array([[0.2, 0.1, 0.28, 0.0], [1.5, 0.0, 0.28, 0.0], [0.2, 0.1, 0.28, 0.0]])  # the second is in the slab
    planner.advance(poses, np.array([0.08, 0.1, 0.1]), np.array([True, True, True]))
    after = planner.paths
    np.testing.assert_array_equal(after.poses[:2], before.poses[:2])
    np.testing.assert_allclose(after.poses[2, 0], poses[2], atol=1e-5)
    assert after.begun.tolist() == pytest.approx([0.0, 0.0, 0.1])
    assert np.linalg.norm(after.rates[2, 0]) > 0.5  # at the best velocity, not from rest


def test_planners_on_the_host_are_refused_in_mjx():
    with pytest.raises(ValueError, match='planner = "replan" asks the expert'):
        EvaluationSettings(backend="mjx", planner="replan")
    EvaluationSettings(backend="mjx", planner="straight")
