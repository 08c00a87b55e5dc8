"""The held-out test: its starts, its numbers, its worst paths."""

import numpy as np
import pytest

from agile_jax.dataset import DatasetSettings, unseen_starts
from agile_jax.dataset.starts import draw_start
from agile_jax.expert import ExpertSettings, planning_margin
from agile_jax.scene import SceneSettings, TableSettings, clearance, make_scene, streams
from agile_jax.training import KinematicTestSettings
from agile_jax.training.kinematic_test.follow import ARRIVED, COLLIDED, STALLED, TIMEOUT, Followed
from agile_jax.training.kinematic_test.held_out import (
    summarise,
    worst_rows,
)

TABLE = TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25)
AFTER, BETWEEN, ROUNDS = streams.KINEMATIC_TEST_STARTS, streams.INTERMEDIATE_TEST_STARTS, streams.AGGREGATION_STARTS
SCENE, EXPERT = SceneSettings(obstacles=(TABLE,)), ExpertSettings()


def loops(outcome, clearances, errors=None):
    count = len(outcome)
    errors = np.zeros(count) if errors is None else np.array(errors)
    return Followed(np.array(outcome, np.int8), np.zeros(count), np.array(clearances), errors, np.zeros((count, 1, 4)))


def test_starts_are_free_and_of_streams_of_their_own():
    keys = [(0, AFTER), (0, BETWEEN), (0, ROUNDS, 0), (0, ROUNDS, 1), (1, AFTER)]
    drawn = [unseen_starts(SCENE, EXPERT, 200, key) for key in keys]
    world = make_scene(SCENE)
    labels = np.concatenate([draw_start(world, SCENE, EXPERT, DatasetSettings(), 0, i).poses for i in range(200)])
    together = np.concatenate([*drawn, labels])
    assert len(np.unique(together[:, :3], axis=0)) == len(together)
    assert clearance(world, together).min() >= planning_margin(EXPERT)
    np.testing.assert_array_equal(unseen_starts(SCENE, EXPERT, 50, keys[0]), drawn[0][:50])


def test_summary_counts_each_outcome_and_takes_quantiles_of_those_that_arrived():
    followed = loops(
        [ARRIVED] * 6 + [COLLIDED, COLLIDED, STALLED, TIMEOUT], np.linspace(-0.02, 0.07, 10), np.arange(10.0)
    )
    found = summarise(followed, np.array([1.0, 1.1, 1.2, 1.3, 1.4, 1.5]), KinematicTestSettings())
    assert (found["field_arrived_rate"], found["field_collision_rate"]) == (0.6, 0.2)
    assert (found["field_stall_rate"], found["field_timeout_rate"]) == (0.1, 0.1)
    assert found["field_time_ratio_median"] == 1.2
    assert found["field_final_error_m_max"] == 9
    assert found["field_min_clearance_m"] == -0.02
    nothing = summarise(loops([STALLED], [np.inf]), np.empty(0), KinematicTestSettings())
    assert nothing["field_time_ratio_median"] is None
    assert nothing["field_min_clearance_m"] is None


def test_worst_rows_are_the_failures_then_the_nearest_then_the_latest(monkeypatch):
    monkeypatch.setattr("agile_jax.training.kinematic_test.held_out.WORST", 2)
    followed = loops([ARRIVED, STALLED, ARRIVED, ARRIVED, ARRIVED], [0.3, 0.4, 0.01, 0.2, 0.02])
    rows = worst_rows(followed, np.array([1.0, np.inf, 1.1, 1.4, 1.5]))
    assert rows.tolist() == [1, 2, 4, 3]
    assert worst_rows(loops([ARRIVED], [0.1]), np.array([1.0])).tolist() == [0]
    assert pytest.approx(1.0) == loops([ARRIVED], [0.1]).rate(ARRIVED)
