"""The summary of an evaluation from its episodes."""

import numpy as np
from jaxtyping import Float

from agile_jax.control import ControlSettings, Counts
from agile_jax.evaluation.kept import Columns
from agile_jax.evaluation.statistics import wilson_interval
from agile_jax.simulation import OUTCOME_NAMES


def finite_or_none(value: float | np.floating) -> float | None:
    """JSON has no NaN: a quantity without a sample is null."""
    return float(value) if np.isfinite(value) else None


def arrival_ratios(columns: Columns) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Arrival times of episodes that succeed over two times of the expert from the same start; NaN elsewhere.

    An episode arrives when it enters the target's tolerance for good.

    Returns:
        Over the time at which the expert's own path enters the same tolerance for good; and over the time of the
        expert's whole path, which ends in the target's centre, so that ratios below one are usual.
    """
    arrival = np.where(columns["success"], columns["arrival_time"], np.nan)
    entered = np.where(columns["expert_arrival_time"] > 0, columns["expert_arrival_time"], np.nan)
    return arrival / entered, arrival / columns["expert_time"]


def summarise(columns: Columns, control: ControlSettings, seconds: float) -> dict[str, object]:
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
    # Entering the tolerance, over the expert's entering it (like with like), and over its reaching the centre.
    same_tolerance, ratio = arrival_ratios(columns)
    solved = np.isfinite(columns["expert_time"])
    simulated = float(columns["steps"].sum()) * control.control_dt

    def quantile(values: np.ndarray, q: float) -> float | None:
        values = values[np.isfinite(values)]
        return float(np.quantile(values, q)) if len(values) else None

    steps = columns["steps"]
    return {
        "episodes": episodes,
        "success_rate": successes / episodes,
        "success_rate_low": low,
        "success_rate_high": high,
        "failures": counts,
        "arrival_time_ratio_same_tolerance_median": quantile(same_tolerance, 0.5),
        "arrival_time_ratio_same_tolerance_p95": quantile(same_tolerance, 0.95),
        "arrival_time_ratio_median": quantile(ratio, 0.5),
        "arrival_time_ratio_p95": quantile(ratio, 0.95),
        "min_clearance_m_p05": quantile(columns["min_clearance"], 0.05),
        "min_self_clearance_m_p05": quantile(columns["min_self_clearance"], 0.05),
        "self_overlaps": int((columns["min_self_clearance"] <= 0).sum()),
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
