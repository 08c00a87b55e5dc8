"""Where and how episodes failed: outcomes by region of the starts, and the distributions behind the medians."""

import numpy as np
from jaxtyping import Float, Int

from agile_jax.evaluation.kept import Columns
from agile_jax.evaluation.summary import arrival_ratios
from agile_jax.robot import GRAVITY
from agile_jax.simulation import OUTCOME_NAMES

QUANTILES = (0.05, 0.5, 0.95)
NEAR_M = 0.3  # a start nearer to an obstacle than this is near [m]


def outcomes_by_region(columns: Columns, start_clearance: Float[np.ndarray, " n"]) -> dict[str, dict[str, int]]:
    """Counts of outcomes by the route that the expert takes from the start, and by its distance to an obstacle.

    Args:
        columns: one entry per episode; `branch` is the route's name where the expert has one.
        start_clearance: of the torso's envelope at the starts [m].
    """
    solved = np.isfinite(columns["expert_time"])
    branches = np.where(solved, columns["branch"], "no path")
    regions = {f"route {name}": branches == name for name in sorted(set(branches.tolist()))}
    near = start_clearance < NEAR_M
    regions |= {f"nearer than {NEAR_M:g} m": near, f"{NEAR_M:g} m and farther": ~near}
    return {name: _counts(columns["outcome"][chosen]) for name, chosen in regions.items() if chosen.any()}


def _counts(outcome: Int[np.ndarray, " n"]) -> dict[str, int]:
    return {name: int((outcome == code).sum()) for code, name in enumerate(OUTCOME_NAMES)}


def distributions(columns: Columns, mass: float) -> dict[str, list[float] | None]:
    """5 %, 50 % and 95 % quantiles over the episodes, None where there is no value.

    The cost of transport is the positive mechanical work of the joints over weight times distance.

    Args:
        columns: one entry per episode.
        mass: of the robot [kg].
    """
    same_tolerance, ratio = arrival_ratios(columns)
    moved = np.where(columns["distance"] > 0.1, columns["distance"], np.nan)
    values = {
        "arrival_time_ratio_same_tolerance_quantiles": same_tolerance,
        "arrival_time_ratio_quantiles": ratio,
        "min_clearance_m_quantiles": columns["min_clearance"],
        "min_envelope_clearance_m_quantiles": columns["min_envelope_clearance"],
        "min_self_clearance_m_quantiles": columns["min_self_clearance"],
        "velocity_tracking_rmse_quantiles": columns["velocity_tracking_rmse"],
        "cost_of_transport_quantiles": columns["work"] / (mass * GRAVITY * moved),
        "torque_saturation_quantiles": columns["torque_saturation"],
    }
    return {name: _quantiles(np.asarray(value, float)) for name, value in values.items()}


def _quantiles(values: Float[np.ndarray, " n"]) -> list[float] | None:
    values = values[np.isfinite(values)]
    return [float(q) for q in np.quantile(values, QUANTILES)] if len(values) else None
