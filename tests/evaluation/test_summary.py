"""The evaluation's summary from known episodes, and its files."""

import json

import numpy as np
import pytest

from agile_jax.control import ControlSettings, Counts
from agile_jax.dataset import time_limit
from agile_jax.evaluation.summary import summarise


def columns() -> dict[str, np.ndarray]:
    return {
        "outcome": np.array([0, 0, 1, 2, 3, 4]),
        "success": np.array([True, True, False, False, False, False]),
        "arrival_time": np.array([3.0, 5.0, np.nan, np.nan, np.nan, np.nan]),
        "expert_time": np.array([3.0, 4.0, 3.0, 3.0, 3.0, np.nan]),
        "expert_arrival_time": np.array([2.5, 3.8, 2.5, 2.5, 2.5, np.nan]),
        "min_clearance": np.array([0.02, 0.03, -0.01, 0.02, 0.2, 0.1]),
        "min_self_clearance": np.array([0.01, 0.011, 0.01, -0.002, 0.01, 0.01]),
        "final_error": np.array([0.01, 0.03, 1.0, 1.0, 1.0, np.nan]),
        "velocity_tracking_rmse": np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1]),
        "torque_saturation": np.zeros(6),
        "steps": np.array([1000, 1000, 500, 500, 500, 500]),
        **{name: np.zeros(6, int) for name in Counts._fields},
        "mpc_failures": np.array([0, 0, 0, 0, 0, 3]),
        "joint_violations": np.array([0, 0, 4, 0, 0, 3]),
        "plans": np.array([100, 100, 50, 50, 50, 50]),
    }


def test_summary_of_known_episodes():
    summary = summarise(columns(), ControlSettings(), seconds=4.0)
    assert summary["success_rate"] == pytest.approx(2 / 6)
    assert summary["failures"] == {"collision": 1, "fall": 1, "timeout": 1, "unstable": 1}
    assert summary["arrival_time_ratio_median"] == pytest.approx((1.0 + 1.25) / 2)
    assert summary["arrival_time_ratio_same_tolerance_median"] == pytest.approx((3.0 / 2.5 + 5.0 / 3.8) / 2)
    assert summary["velocity_tracking_rmse"] == pytest.approx(0.1)
    assert summary["mpc_failures"] == 3
    assert (summary["cone_violations"], summary["torque_violations"], summary["joint_violations"]) == (0, 0, 7)
    assert summary["expert_failures"] == 1
    assert summary["self_overlaps"] == 1
    assert summary["min_self_clearance_m_p05"] == pytest.approx(-0.002 + 0.25 * 0.012)
    assert summary["simulated_seconds_per_second"] == pytest.approx(4000 * 0.002 / 4.0)
    json.dumps(summary, allow_nan=False)


def test_summary_without_a_success_has_nulls_not_nans():
    failed = columns() | {"outcome": np.full(6, 3), "success": np.zeros(6, bool), "arrival_time": np.full(6, np.nan)}
    summary = summarise(failed, ControlSettings(), seconds=1.0)
    assert summary["arrival_time_ratio_median"] is None
    assert summary["success_rate"] == 0
    json.dumps(summary, allow_nan=False)


def test_time_limit_is_twice_the_experts_time_and_three_seconds():
    np.testing.assert_allclose(time_limit(np.array([2.0, np.nan])), [7.0, 20.0])
