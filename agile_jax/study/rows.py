"""A study in numbers: one flat row for each value, from the summaries of its evaluations."""

import csv
import io
import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from agile_jax.files import read_json
from agile_jax.run_directory import stage_paths
from agile_jax.study.settings import StudySettings
from agile_jax.sweep.trials import Trial, aligned

Row = dict[str, object]

TAKEN = {  # by column: the key of the evaluation's summary, with units in the names
    "episodes": "episodes",
    "success_rate": "success_rate",
    "success_rate_low": "success_rate_low",
    "success_rate_high": "success_rate_high",
    "arrival_time_ratio_same_tolerance_median": "arrival_time_ratio_same_tolerance_median",
    "arrival_time_ratio_same_tolerance_p95": "arrival_time_ratio_same_tolerance_p95",
    "min_clearance_m_p05": "min_clearance_m_p05",
    "velocity_tracking_rmse_m_s": "velocity_tracking_rmse",
    "torque_saturation_fraction": "torque_saturation_fraction",
    "mpc_failures": "mpc_failures",
    "expert_failures": "expert_failures",
}
ROUTE = "route "  # begins the names of the regions of starts that are told apart by the expert's route


def value_column(settings: StudySettings) -> str:
    """The column of the varied number, with its unit."""
    return "_".join(["value", *re.findall(r"\w+", settings.unit)])


def make_rows(settings: StudySettings, trials: Sequence[Trial]) -> list[Row]:
    """One row a trial, with the same columns in the same order.

    `starts_X` and `successes_X` count the starts from which the expert's path has the branch X, such as "under" or
    "left" ("no_path" where it has none). What is not known is None.
    """
    rows = [_row(settings, trial) for trial in trials]
    columns = dict.fromkeys(name for row in rows for name in row)
    counts = {name for name in columns if name.startswith(("starts_", "successes_", "failures_"))}

    def lacking(row: Row, name: str) -> object:
        return 0 if name in counts and row["status"] == "done" else None

    return [{name: row.get(name, lacking(row, name)) for name in columns} for row in rows]


def _row(settings: StudySettings, trial: Trial) -> Row:
    row: Row = {"curve": curve_name(settings, trial), value_column(settings): trial.values[settings.vary[0]]}
    row |= {"hash": trial.hash, "run_dir": f"trials/{trial.run_dir.name}", "status": trial.status, "cause": trial.cause}
    summary = summary_of(trial) if trial.status == "done" else {}
    row |= {column: summary.get(key) for column, key in TAKEN.items()}
    quantiles = summary.get("min_clearance_m_quantiles")
    row["min_clearance_m_median"] = quantiles[1] if isinstance(quantiles, list) else None
    row |= {f"failures_{cause}": count for cause, count in _table(summary, "failures").items()}
    for region, counts in _table(summary, "outcomes_by_region").items():
        if region.startswith(ROUTE) and isinstance(counts, Mapping):
            branch = region.removeprefix(ROUTE).replace(" ", "_")
            row |= {f"starts_{branch}": sum(counts.values()), f"successes_{branch}": counts["success"]}
    return row


def _table(summary: Mapping[str, object], key: str) -> Mapping[str, object]:
    found = summary.get(key)
    return found if isinstance(found, Mapping) else {}


def summary_of(trial: Trial) -> Mapping[str, object]:
    """The summary of a trial's evaluation; empty when it cannot be read."""
    return read_json(stage_paths(trial.run_dir, trial.experiment, "evaluation").summary) or {}


def curve_name(settings: StudySettings, trial: Trial) -> str:
    """What tells a trial's curve from the others; "" where there is one."""
    return ", ".join(f"{key.rpartition('.')[2]} {trial.values[key]}" for key in settings.curves)


def of_curves(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each curve."""
    return {
        name: [row for row in rows if row["curve"] == name] for name in dict.fromkeys(str(r["curve"]) for r in rows)
    }


def to_curves(settings: StudySettings, rows: Sequence[Row]) -> dict[str, dict[str, Float[np.ndarray, " n"]]]:
    """The numbers of the values that are done, as columns of each curve; NaN: not known. What the figure shows."""
    found = {}
    for curve, own in of_curves(rows).items():
        done = [row for row in own if row["status"] == "done"]
        numbers = [name for name in own[0] if not any(isinstance(row[name], str) for row in own)]
        columns = {
            name: np.array([np.nan if row[name] is None else row[name] for row in done], float) for name in numbers
        }
        if done:
            found[curve] = columns | {"value": columns[value_column(settings)]}
    return found


def sentences(settings: StudySettings, rows: Sequence[Row]) -> list[str]:
    """Where the robot holds, and where it breaks, of each curve."""
    column, found = value_column(settings), []
    for curve, own in of_curves(rows).items():
        done = [row for row in own if row["status"] == "done"]
        stretch = longest_stretch([_number(row, "success_rate") >= settings.hold for row in done])
        text = f"{curve}: " * bool(curve) + f"{len(done)} of {len(own)} values are evaluated. "
        least = f"at least {100 * settings.hold:g} % of the starts succeed"
        if stretch is None:
            text += f"At none of them {least}."
        else:
            first, last = (f"{done[i][column]:g} {settings.unit}".rstrip() for i in (stretch[0], stretch[1]))
            text += f"From {first} to {last} {least}."
            broken = [i for i in (stretch[0] - 1, stretch[1] + 1) if 0 <= i < len(done)]
            for i in broken:
                text += (
                    f" At {done[i][column]:g} {settings.unit}".rstrip()
                    + f" {100 * _number(done[i], 'success_rate'):.3g} % do."
                )
        found.append(text)
    return found


def longest_stretch(flags: Sequence[bool]) -> tuple[int, int] | None:
    """First and last place of the longest run of true flags, of several the last; None where there is none."""
    best, begun = None, 0
    for place, flag in enumerate(flags):
        if not flag:
            begun = place + 1
        elif best is None or place - begun >= best[1] - best[0]:
            best = begun, place
    return best


def _number(row: Row, column: str) -> float:
    value = row[column]
    return float(value) if isinstance(value, int | float) else float("nan")


def table(settings: StudySettings, rows: Sequence[Row]) -> str:
    """The rows as text, with the numbers that matter most."""
    value = value_column(settings)
    head = ["curve"] * bool(settings.curves) + [value, "success", "95 %", "clearance p05", "arrival", "status"]
    lines = [head]
    for row in rows:
        rate, low, high = (
            f"{100 * _number(row, name):.4g}"
            for name in ("success_rate", *(f"success_rate_{end}" for end in ("low", "high")))
        )
        known = row["status"] == "done"
        cells = [
            f"{rate} %",
            f"{low} to {high}",
            f"{1e3 * _number(row, 'min_clearance_m_p05'):.1f} mm",
            f"{_number(row, 'arrival_time_ratio_same_tolerance_median'):.3f}",
        ]
        lines.append(
            [str(row["curve"])] * bool(settings.curves)
            + [f"{row[value]:g}"]
            + (cells if known else [""] * len(cells))
            + [str(row["status"]) + (f": {row['cause']}" if row["cause"] else "")]
        )
    return aligned(lines)


def to_csv(rows: Sequence[Row]) -> bytes:
    """The rows as a CSV file; what is not known is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()
