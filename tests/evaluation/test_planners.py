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


def test_the_first_path_is_the_experts_from_rest():
    planner = ExpertPlanner(SCENE, SETTINGS, 2, None)
    planner.begin(np.array([1]), START[None])
    expected = make_expert(SCENE, SETTINGS).solve(START, initial_velocity="rest").trajectory
    np.testing.assert_allclose(planner.paths.times[1], expected.times, atol=1e-6)
    np.testing.assert_allclose(planner.paths.poses[1], expected.states[:, :4], atol=1e-6)
    planner.advance(np.tile(START, (2, 1)), np.array([5.0, 5.0]), np.array([True, True]))
    assert len(planner.solve_times) == 1  # open loop asks once


def test_it_plans_again_when_due_and_keeps_its_path_where_there_is_none():
    planner = ExpertPlanner(SCENE, SETTINGS, 3, 0.1)
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
