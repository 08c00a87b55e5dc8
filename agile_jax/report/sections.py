"""The report's tables: what the summaries of a run say, in words and with units."""

import pathlib
import tomllib
from typing import Any

from agile_jax.report.page import Section, cards, listing, paragraph, table
from agile_jax.report.reading import read_json

_MSE = "(m/s)², (rad/s)²"
_DATASET = {
    "trajectories": ("accepted trajectories", ""),
    "attempted": ("starts attempted", ""),
    "rejected_starts": ("starts rejected (in collision or out of bounds)", ""),
    "failed": ("failed, by cause", ""),
    "unverified": ("unverified trajectories in the data", ""),
    "branches": ("branches", ""),
    "optimality_gap_median": ("duration over its lower bound, minus 1, median", ""),
    "max_clearance_violation_m": ("largest clearance violation", "m"),
    "max_dynamics_residual": ("largest dynamics residual", "SI"),
    "labels_per_second": ("labels per second", "1/s"),
    "solve_time_ms_median": ("solve time, median", "ms"),
    "workers": ("worker processes", ""),
    "dataset_hash": ("hash", ""),
}
_TRAINING = {
    "train_mse": ("train error", _MSE),
    "validation_mse": ("validation error", _MSE),
    "test_mse": ("test error", _MSE),
    "noise_floor_mse": ("noise floor of the labels", _MSE),
    "noise_floor_share": ("its share in what neighbours differ by: above 0.5 it is meaningful", ""),
    "field_starts": ("kinematic closed loop: starts that no training has seen", ""),
    "field_arrived_rate": ("of these, arrived", ""),
    "field_collision_rate": ("collided", ""),
    "field_stall_rate": ("stalled", ""),
    "field_timeout_rate": ("out of time", ""),
    "field_final_error_m_max": ("largest distance to the target at the end", "m"),
    "field_time_ratio_median": ("arrival time over the expert's, median", ""),
    "field_time_ratio_p95": ("arrival time over the expert's, 95th percentile", ""),
    "field_min_clearance_m": ("least clearance", "m"),
    "dagger_asked": ("poses asked about in rounds of aggregation", ""),
    "epochs": ("epochs", ""),
    "parameters": ("parameters", ""),
    "seconds": ("training time", "s"),
    "compile_seconds": ("compilation", "s"),
    "device": ("device", ""),
}
_EVALUATION = {
    "episodes": ("episodes", ""),
    "success_rate": ("success rate", ""),
    "success_rate_low": ("lower end of its 95 % Wilson interval", ""),
    "success_rate_high": ("upper end of its 95 % Wilson interval", ""),
    "arrival_time_ratio_median": ("arrival time over the expert's, median", ""),
    "arrival_time_ratio_p95": ("arrival time over the expert's, 95th percentile", ""),
    "min_clearance_m_p05": ("least clearance of the robot in an episode, 5th percentile", "m"),
    "cost_of_transport_quantiles": ("cost of transport, 5 %, 50 %, 95 %", ""),
    "final_error_m_median": ("final distance to the target, median", "m"),
    "velocity_tracking_rmse": ("velocity tracking error, root mean square", "m/s, rad/s"),
    "torque_saturation_fraction": ("torques at their limit, fraction", ""),
    "mpc_solutions": ("MPC problems", ""),
    "mpc_failures": ("MPC problems not solved", ""),
    "cone_violations": ("plans with a force outside its friction cone", ""),
    "torque_violations": ("commands with a torque over its limit", ""),
    "joint_violations": ("commands at which a joint was past its limit", ""),
    "simulated_seconds_per_second": ("simulated seconds per second", ""),
    "seconds": ("time", "s"),
    "device": ("device", ""),
}


def percent(value: Any) -> str:
    """A fraction as a percentage."""
    return f"{100 * value:.1f} %" if isinstance(value, int | float) else "–"


def _named(summary: dict[str, Any], names: dict[str, tuple[str, str]]) -> str:
    known = [(*names[key][:1], summary[key], names[key][1]) for key in names if key in summary]
    others = [(key, value, "") for key, value in sorted(summary.items()) if key not in names]
    extra = ""
    if others:
        extra = "<details><summary>further entries</summary>" + table(("", "value", ""), others) + "</details>"
    return table(("", "value", "unit"), known) + extra


def overview(
    dataset: dict[str, Any] | None, training: dict[str, Any] | None, evaluations: dict[str, dict[str, Any]]
) -> str:
    """The run in a few large numbers."""
    entries = []
    for backend, result in evaluations.items():
        interval = f"{percent(result.get('success_rate_low'))} to {percent(result.get('success_rate_high'))}"
        label = f"success, {backend}, {result.get('episodes', '–')} starts (95 %: {interval})"
        entries.append((percent(result.get("success_rate")), label))
        entries.append(
            (_short(result.get("arrival_time_ratio_median")), f"arrival time over the expert's, {backend}, median")
        )
    if training:
        floor = _short(training.get("noise_floor_mse"))
        entries.append((_short(training.get("validation_mse")), f"validation error (noise floor {floor})"))
    if dataset:
        entries.append((str(dataset.get("trajectories", "–")), "verified expert trajectories"))
    return cards(entries) if entries else paragraph("No stage of this run has finished yet.")


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, int | float) else "–"


def dataset_table(summary: dict[str, Any] | None) -> str:
    """Counts, branches, failures and quality of the labels."""
    if summary is None:
        return paragraph("There is no dataset yet.")
    return _named(summary, _DATASET)


def training_table(summary: dict[str, Any] | None) -> str:
    """Errors against the noise floor, and cost."""
    if summary is None:
        return paragraph("The policy has not been trained yet.")
    words = ""
    error, floor = summary.get("validation_mse"), summary.get("noise_floor_mse")
    if isinstance(error, int | float) and isinstance(floor, int | float) and floor > 0:
        words = paragraph(
            f"The validation error is {error / floor:.2g} times the noise floor, which is how much the labels of "
            "neighbouring poses differ. "
            + (
                "The floor is uncertain, most likely too high: labels are far apart, or change their route in between."
                if isinstance(share := summary.get("noise_floor_share"), int | float) and share < 0.5
                else ""
            )
        )
    return words + _named(summary, _TRAINING)


def evaluation_table(summary: dict[str, Any]) -> str:
    """Success with its interval, failures by cause, quality."""
    episodes = summary.get("episodes")
    words = (
        f"{percent(summary.get('success_rate'))} of {episodes if episodes is not None else '–'} episodes succeeded "
        f"(95 % Wilson interval {percent(summary.get('success_rate_low'))} to "
        f"{percent(summary.get('success_rate_high'))})."
    )
    failures = summary.get("failures")
    causes = ""
    if isinstance(failures, dict):
        causes = table(("failure", "episodes"), sorted(failures.items()))
    regions = summary.get("outcomes_by_region")
    if (
        isinstance(regions, dict)
        and all(isinstance(counts, dict) and counts for counts in regions.values())
        and regions
    ):
        names = list(next(iter(regions.values())))
        rows = [(region, *(counts.get(name, 0) for name in names)) for region, counts in regions.items()]
        causes += table(("starts", *names), rows)
    rest = {key: value for key, value in summary.items() if key not in ("backend", "failures", "outcomes_by_region")}
    return paragraph(words) + causes + _named(rest, _EVALUATION)


def settings_section(run_dir: pathlib.Path) -> Section:
    """The resolved experiment file, folded."""
    path = run_dir / "experiment.toml"
    if not path.is_file():
        return Section("settings", "Settings", paragraph("The run holds no experiment.toml."))
    content = path.read_text(encoding="utf-8", errors="replace")
    try:
        tomllib.loads(content)
    except tomllib.TOMLDecodeError as error:
        words = f"experiment.toml is damaged: {error}"
    else:
        words = "The experiment as it was resolved: every default is written out."
    return Section("settings", "Settings", paragraph(words) + listing("experiment.toml", content))


def environment_table(run_dir: pathlib.Path) -> str:
    """Versions, seed and hash."""
    values = read_json(run_dir / "environment.json")
    return paragraph("The run holds no environment.json.") if values is None else table(("", ""), _flat(values))


def _flat(values: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in sorted(values.items()):
        if isinstance(value, dict):
            rows += _flat(value, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", value))
    return rows
