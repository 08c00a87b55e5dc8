"""The report's tables: what the summaries of a run say, in words and with units."""

import pathlib
import tomllib
from collections.abc import Mapping

from agile_jax.files import read_json
from agile_jax.report import definitions
from agile_jax.report.json_files import Summary
from agile_jax.report.outdated import summaries
from agile_jax.report.page import Section, cards, listing, paragraph, table
from agile_jax.scene import SceneSettings

Words = Mapping[str, tuple[str, str]]  # by the key of a summary: what it is, and its unit
_DATASET: Words = {
    "trajectories": ("accepted trajectories", ""),
    "attempted": ("starts attempted", ""),
    "rejected_starts": ("starts rejected (in collision or out of bounds)", ""),
    "failed": ("failed, by cause", ""),
    "unverified": ("unverified trajectories in the data", ""),
    "branches": ("routes of the paths", ""),
    "optimality_gap_median": ("duration over its lower bound, minus 1, median", ""),
    "max_clearance_violation_m": ("largest violation of the margin to obstacles", "m"),
    "max_dynamics_residual": (
        "largest deviation of a state from the integral of the accelerations",
        "m, rad, m/s, rad/s",
    ),
    "labels_per_second": ("labels per second", "1/s"),
    "solve_time_ms_median": ("solve time, median", "ms"),
    "workers": ("worker processes", ""),
    "dataset_hash": ("hash", ""),
}
_TEST = "kinematic test: "
_TRAINING: Words = {
    "train_mse": ("error on the training trajectories", "MSE"),
    "validation_mse": ("error on the validation trajectories", "MSE"),
    "test_mse": ("error on the test trajectories", "MSE"),
    "noise_floor_mse": ("noise floor of the labels", "MSE"),
    "noise_floor_share": (
        "share of the floor in what the nearest labels differ by: near 1 it was measured, near 0 guessed",
        "",
    ),
    "field_starts": (f"{_TEST}starts that no training has seen", ""),
    "field_arrived_rate": (f"{_TEST}starts that arrived", "%"),
    "field_collision_rate": (f"{_TEST}starts that collided", "%"),
    "field_stall_rate": (f"{_TEST}starts that stalled", "%"),
    "field_timeout_rate": (f"{_TEST}starts that ran out of time", "%"),
    "field_final_error_m_max": (f"{_TEST}largest distance to the target at the end", "m"),
    "field_time_ratio_median": (f"{_TEST}arrival time over the duration of the expert's path, median", ""),
    "field_time_ratio_p95": (f"{_TEST}the same, 95th percentile", ""),
    "field_min_clearance_m": (f"{_TEST}least clearance of the torso", "m"),
    "aggregation_asked": ("poses that rounds of aggregation asked the expert about", ""),
    "aggregation_answered": ("of these, answered", ""),
    "epochs": ("epochs", ""),
    "parameters": ("parameters", ""),
    "seconds": ("training time", "s"),
    "compile_seconds": ("compilation", "s"),
    "device": ("device", ""),
}
_EVALUATION: Words = {
    "episodes": ("episodes", ""),
    "rejected_starts_share": ("draws of the start distribution that no episode starts from", "%"),
    "rejected_starts_collision_share": ("of all draws: nearer to an obstacle than the expert's margin", "%"),
    "rejected_starts_bounds_share": ("of all draws: out of bounds", "%"),
    "success_rate": ("success rate", "%"),
    "success_rate_low": ("lower end of its 95 % Wilson interval", "%"),
    "success_rate_high": ("upper end of its 95 % Wilson interval", "%"),
    "arrival_time_ratio_same_tolerance_median": ("arrival time over that of the expert's path, median", ""),
    "arrival_time_ratio_same_tolerance_p95": ("arrival time over that of the expert's path, 95th percentile", ""),
    "arrival_time_ratio_median": ("arrival time over the duration of the expert's whole path, median", ""),
    "arrival_time_ratio_p95": ("arrival time over the duration of the expert's whole path, 95th percentile", ""),
    "min_clearance_m_p05": ("least clearance of the robot in an episode, 5th percentile", "m"),
    "min_self_clearance_m_p05": ("least distance of the legs to the trunk and to each other, 5th percentile", "m"),
    "self_overlaps": ("episodes in which a leg reached into the trunk or another leg, which nothing stops", ""),
    "cost_of_transport_quantiles": ("cost of transport, 5 %, 50 %, 95 %", ""),
    "final_error_m_median": ("final distance to the target in the plane, median", "m"),
    "velocity_tracking_rmse": ("error of the trunk's velocity in the plane, root mean square", "m/s"),
    "torque_saturation_fraction": ("torques at their limit", "%"),
    "mpc_solutions": ("MPC problems", ""),
    "mpc_failures": ("MPC problems not solved", ""),
    "cone_violations": ("plans with a force outside its friction cone", ""),
    "torque_violations": ("commands with a torque over its limit", ""),
    "joint_violations": ("commands at which a joint was past its limit", ""),
    "simulated_seconds_per_second": ("simulated seconds per second", ""),
    "seconds": ("time", "s"),
    "device": ("device", ""),
}
MEANINGFUL_SHARE = 0.5  # below which the noise floor is no more than a guess (training/noise_floor.py)


def error_unit(policy_kind: str) -> str:
    """The units of the policy's four outputs."""
    return "m/s², yaw: rad/s²" if policy_kind == "feedback" else "m/s, yaw: rad/s"


def squared_error_unit(policy_kind: str) -> str:
    """The units of the policy's four outputs, squared."""
    return "(m/s²)², yaw: (rad/s²)²" if policy_kind == "feedback" else "(m/s)², yaw: (rad/s)²"


def percent(value: object) -> str:
    """A fraction as a percentage."""
    return _formatted(value, ".1%").replace("%", " %")


def _formatted(value: object, form: str) -> str:
    return format(value, form) if isinstance(value, int | float) else "–"


def _named(summary: Summary, names: Words, squared_error: str = "") -> str:
    known = []
    for key in names:
        words, unit = names[key]
        value = summary.get(key)
        if unit == "%" and isinstance(value, int | float):
            value = round(100 * value, 2)
        if key in summary:
            known.append((words, value, squared_error if unit == "MSE" else unit))
    others = [(key, value, "") for key, value in sorted(summary.items()) if key not in names]
    extra = ""
    if others:
        extra = "<details><summary>further entries</summary>" + table(("", "value", ""), others) + "</details>"
    return table(("", "value", "unit"), known) + extra


def overview(
    dataset: Summary | None, training: Summary | None, evaluations: Mapping[str, Summary], scene: SceneSettings
) -> str:
    """The run in a few large numbers, and what they mean."""
    entries = []
    for backend, result in evaluations.items():
        interval = f"{percent(result.get('success_rate_low'))} to {percent(result.get('success_rate_high'))}"
        label = f"success, {backend}, {result.get('episodes', '–')} starts (95 %: {interval})"
        entries.append((percent(result.get("success_rate")), label))
        ratio = _formatted(result.get("arrival_time_ratio_same_tolerance_median"), ".3f")
        entries.append((ratio, f"arrival time over the expert's, {backend}, median"))
    if training:
        floor = _formatted(training.get("noise_floor_mse"), ".3g")
        entries.append((_formatted(training.get("validation_mse"), ".3g"), f"validation error (noise floor {floor})"))
    if dataset:
        entries.append((str(dataset.get("trajectories", "–")), "verified expert trajectories"))
    words = "".join(paragraph(text) for text in (definitions.success(), definitions.ARRIVAL) if evaluations)
    words += paragraph(definitions.obstacles(scene)) if scene.obstacles else ""
    return (cards(entries) if entries else paragraph("No stage of this run has finished yet.")) + words


def dataset_table(summary: Summary | None) -> str:
    """Counts, branches, failures and quality of the labels."""
    if summary is None:
        return paragraph("There is no dataset yet.")
    return _named(summary, _DATASET)


def training_table(summary: Summary | None, policy_kind: str) -> str:
    """Errors against the noise floor, and cost."""
    if summary is None:
        return paragraph("The policy has not been trained yet.")
    words = (
        "Errors are means of squares over the policy's four outputs. The noise floor is what no field can get below: "
        "how much the labels of neighbouring poses differ. In the kinematic test a point robot follows the policy."
    )
    error, floor = summary.get("validation_mse"), summary.get("noise_floor_mse")
    if isinstance(error, int | float) and isinstance(floor, int | float) and floor > 0:
        words += f" The validation error is {error / floor:.2g} times the noise floor."
    if isinstance(share := summary.get("noise_floor_share"), int | float) and share < MEANINGFUL_SHARE:
        words += (
            " The floor is uncertain and most likely too high: the labels are far apart, or their route changes in "
            "between."
        )
    return paragraph(words) + _named(summary, _TRAINING, squared_error_unit(policy_kind))


def evaluation_table(summary: Summary) -> str:
    """Success with its interval, failures by cause, quality."""
    episodes = summary.get("episodes")
    words = (
        f"{percent(summary.get('success_rate'))} of {episodes if episodes is not None else '–'} episodes succeeded "
        f"(95 % Wilson interval {percent(summary.get('success_rate_low'))} to "
        f"{percent(summary.get('success_rate_high'))})."
    )
    if "rejected_starts_share" in summary:
        words += (
            f" {percent(summary['rejected_starts_share'])} of the draws of the scene's start distribution are left out "
            "before, because they are nearer to an obstacle than the expert's margin, "
            f"{percent(summary.get('rejected_starts_collision_share'))}, or out of bounds, "
            f"{percent(summary.get('rejected_starts_bounds_share'))}."
        )
    failures = summary.get("failures")
    causes = table(("failure", "episodes"), sorted(failures.items())) if isinstance(failures, dict) else ""
    regions = summary.get("outcomes_by_region")
    if (
        isinstance(regions, dict)
        and regions
        and all(isinstance(counts, dict) and counts for counts in regions.values())
    ):
        names = list(next(iter(regions.values())))
        rows = [(region, *(counts.get(name, 0) for name in names)) for region, counts in regions.items()]
        causes += paragraph(definitions.STARTS) + table(("starts", *names), rows)
    rest = {key: value for key, value in summary.items() if key not in ("backend", "failures", "outcomes_by_region")}
    return paragraph(words) + causes + _named(rest, _EVALUATION)


def sources(run_dir: pathlib.Path) -> str:
    """Of which results the page tells: the key of each, where a record names it, and its summary's hash."""
    rows = [(path, _key(run_dir, path), digest[:16]) for path, digest in summaries(run_dir).items()]
    return table(("this report tells of", "key", "sha256 of the summary"), rows) if rows else ""


def _key(run_dir: pathlib.Path, summary: str) -> str:
    """The key under which the result of a summary is kept, as it or its record says; "" where there is none."""
    path = run_dir / summary
    record = read_json(path.with_name("stage.json")) or {}  # an evaluation has none there
    return str((read_json(path) or {}).get("evaluation_key") or record.get("key") or "")[:16]


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
    words = "The run holds no environment.json that can be read."
    return paragraph(words) if values is None else table(("", ""), _flat(values))


def _flat(values: Summary, prefix: str = "") -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = []
    for key, value in sorted(values.items()):
        if isinstance(value, dict):
            rows += _flat(value, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", value))
    return rows
