"""The trials of a sweep: the points of the grid as validated experiments, their states and their table."""

import itertools
import math
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

from agile_jax.experiment import Experiment, experiment_hash, with_overrides
from agile_jax.files import read_json
from agile_jax.pipeline import stages_for
from agile_jax.settings import BadInput
from agile_jax.sweep.settings import SweepSettings


class Trial(NamedTuple):
    """One point of the sweep. Its identity is the hash of its resolved experiment, not its number."""

    hash: str
    values: Mapping[str, object]  # what is varied, by dotted key
    experiment: Experiment
    run_dir: pathlib.Path
    stages: tuple[str, ...]  # that it runs
    status: Literal["new", "done", "failed"] = "new"
    metric: float | None = None
    cause: str = ""  # of a failure
    seconds: float = 0.0  # spent on it by the process that finished it
    shown: tuple[float | None, ...] = ()  # the numbers that the sweep shows beside its metric


class Number(NamedTuple):
    """A number of a trial's summaries."""

    value: float | None
    cause: str  # why there is none, or ""


def make_trials(experiment: Experiment, sweep_dir: pathlib.Path) -> list[Trial]:
    """Every point of the sweep, validated; equal points once. All errors of all points at once.

    Raises:
        BadInput: the experiment has no [sweep], or a point is no valid experiment.
    """
    settings = sweep_settings(experiment)
    points = settings.points or grid(settings.space)
    wanted = {key.split(".")[0] for key in (settings.metric, *settings.show)}
    return trials_at(points, experiment, sweep_dir, wanted, "sweep.points" if settings.points else "sweep.space")


def grid(space: Mapping[str, Sequence[object]]) -> list[dict[str, object]]:
    """Every combination of the values of some dotted keys; the last key varies fastest."""
    return [dict(zip(space, point, strict=True)) for point in itertools.product(*space.values())]


def trials_at(
    points: Iterable[Mapping[str, object]],
    experiment: Experiment,
    folder: pathlib.Path,
    wanted: Iterable[str],
    source: str,
) -> list[Trial]:
    """The trials at some points, each run as far as the stages in `wanted` need; `source` names them in messages.

    Raises:
        BadInput: points that are no valid experiments, all errors at once.
    """
    bare = experiment.model_copy(update={"sweep": None, "study": None})
    trials: dict[str, Trial] = {}
    errors: dict[str, None] = {}
    for values in points:
        try:
            trial = with_overrides(bare, values, source)
        except BadInput as error:
            errors.update(dict.fromkeys(str(error).splitlines()))
            continue
        identity = experiment_hash(trial)
        run_dir = folder / "trials" / identity[:12]
        own = {"name": f"{experiment.name[:51]}-{identity[:12]}"}  # going on from a trial is no work in the sweep
        trial = trial.model_copy(update=own)
        trials.setdefault(identity, Trial(identity, values, trial, run_dir, stages_for(trial, wanted)))
    if errors:
        raise BadInput("\n".join(errors))
    return list(trials.values())


def sweep_settings(experiment: Experiment) -> SweepSettings:
    """The experiment's [sweep], or BadInput when it has none."""
    if experiment.sweep is None:
        raise BadInput(
            f"{experiment.name}: the experiment has no [sweep] table with a [sweep.space] or [[sweep.points]]"
        )
    return experiment.sweep


def read_number(key: str, run_dir: pathlib.Path) -> Number:
    """A number of a finished trial's summaries, by stage and key, such as "evaluation.mujoco.success_rate"."""
    stage, *names = key.split(".")
    file = names.pop(0) if stage == "evaluation" else "summary"
    path = run_dir / stage / f"{file}.json"
    value: object = read_json(path)
    for name in names:
        if not isinstance(value, dict) or name not in value:
            known = ", ".join(value) if isinstance(value, dict) else "nothing"
            return Number(None, f"{path} has no {'.'.join(names)}; it has {known}")
        value = value[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return Number(None, f"{key} is {value!r}, which cannot be compared")
    return Number(float(value), "")


def best(settings: SweepSettings, trials: Sequence[Trial]) -> Trial | None:
    """The finished trial with the best metric; the first of equals."""
    sign = 1 if settings.direction == "minimize" else -1
    done = [trial for trial in trials if trial.metric is not None]
    return min(done, key=lambda trial: sign * (trial.metric or 0.0), default=None)


def table(experiment: Experiment, trials: Sequence[Trial]) -> str:
    """The trials as text, the best one marked."""
    settings = sweep_settings(experiment)
    winner = best(settings, trials)
    keys = list(settings.space) or ["point"]
    rows = [["", "trial", *keys, settings.metric, *settings.show, "status", "seconds"]]
    for trial in trials:
        rows.append(
            [
                "*" if winner is not None and trial.hash == winner.hash else "",
                trial.hash[:12],
                *([str(value) for value in trial.values.values()] if settings.space else [point_text(trial.values)]),
                "" if trial.metric is None else f"{trial.metric:.6g}",
                *("" if value is None else f"{value:.6g}" for value in trial.shown or [None] * len(settings.show)),
                trial.status + (f": {trial.cause}" if trial.cause else ""),
                f"{trial.seconds:.1f}" if trial.seconds else "",
            ]
        )
    return aligned(rows)


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of as many cells each, in columns."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def point_text(values: Mapping[str, object]) -> str:
    """What a point changes, in words."""
    return ", ".join(f"{key} = {value}" for key, value in values.items()) or "nothing changed"
