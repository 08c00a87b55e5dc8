"""The summary of an evaluation from its episodes."""

from typing import Any

import numpy as np

from agile_jax.control import ControlSettings, Counts
from agile_jax.evaluation.statistics import wilson_interval
from agile_jax.simulation import OUTCOME_NAMES


def finite_or_none(value: float) -> float | None:
    """JSON has no NaN: a quantity without a sample is null."""
    return float(value) if np.isfinite(value) else None


def summarize(columns: dict[str, np.ndarray], control: ControlSettings, seconds: float) -> dict[str, Any]:
    """Rates, times and quality, with units in the names where a unit exists.

    Args:
        columns: one entry per episode.
        control: for the clocks.
        seconds: wall time of the episodes, compilation included.
    """
    episodes = len(columns["outcome"])
    success = columns["success"]
    successes = int(success.sum())
    low, high = wilson_interval(successes, episodes)
    counts = {name: int((columns["outcome"] == code).sum()) for code, name in enumerate(OUTCOME_NAMES) if code > 0}
    ratio = (columns["arrival_time"] / columns["expert_time"])[success & np.isfinite(columns["expert_time"])]
    finite_clearance = columns["min_clearance"][np.isfinite(columns["min_clearance"])]
    solved = np.isfinite(columns["expert_time"])
    simulated = float(columns["steps"].sum()) * control.control_dt

    def quantile(values: np.ndarray, q: float) -> float | None:
        values = values[np.isfinite(values)]
        return finite_or_none(np.quantile(values, q)) if len(values) else None

    steps = columns["steps"]
    return {
        "episodes": episodes,
        "success_rate": successes / episodes,
        "success_rate_low": low,
        "success_rate_high": high,
        "failures": counts,
        "arrival_time_ratio_median": quantile(ratio, 0.5),
        "arrival_time_ratio_p95": quantile(ratio, 0.95),
        "min_clearance_m_p05": quantile(finite_clearance, 0.05),
        "final_error_m_median": quantile(columns["final_error"], 0.5),
        "velocity_tracking_rmse": finite_or_none(
            np.sqrt(np.average(columns["velocity_tracking_rmse"].astype(float) ** 2, weights=steps))
        ),
        "torque_saturation_fraction": finite_or_none(np.average(columns["torque_saturation"], weights=steps)),
        **{name: int(columns[name].sum()) for name in Counts._fields},
        "mpc_solutions": int(columns["plans"].sum()),
        "expert_failures": int((~solved).sum()),
        "success_rate_where_path": float(success[solved].mean()) if solved.any() else None,
        "simulated_seconds_per_second": simulated / seconds,
        "seconds": seconds,
    }
