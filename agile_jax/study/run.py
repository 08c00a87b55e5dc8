"""Running a study: each value is a trial, with a run directory of its own (sweep/execute.py).

    <study_dir>/experiment.toml, study.json, study.csv, study.png, study.html    rewritten after every value
    <study_dir>/trials/<hash12>/                                                 run directories
    <study_dir>/stages/<stage>-<hash12>/                                         datasets and trainings that they share

The files tell of what is done, and hold no time of work: the same study gives the same bytes.
"""

import itertools
import pathlib
from collections.abc import Sequence
from functools import partial

from agile_jax.experiment import Experiment
from agile_jax.files import read_json, write_atomic, write_json
from agile_jax.progress import Progress, silent
from agile_jax.report import write_study_page
from agile_jax.settings import BadInput
from agile_jax.study.rows import Row, make_rows, sentences, summary_of, to_csv, to_curves
from agile_jax.study.settings import StudySettings
from agile_jax.sweep.execute import recall, run_trials
from agile_jax.sweep.trials import Trial, grid, trials_at


def list_values(experiment: Experiment, study_dir: pathlib.Path) -> list[Trial]:
    """The trials, curve by curve in increasing order of the value, with what is known of them; writes nothing.

    Raises:
        BadInput: the experiment has no [study], or a value makes no valid experiment: all errors at once.
    """
    settings = study_settings(experiment)
    points = [
        curve | dict.fromkeys(settings.vary, value)
        for curve, value in itertools.product(grid(settings.curves), settings.numbers)
    ]
    trials = trials_at(points, experiment, study_dir, ["evaluation"], "study")
    return recall(trials, (read_json(study_dir / "study.json") or {}).get("rows"), _judged)


def run_study(
    experiment: Experiment,
    study_dir: pathlib.Path,
    *,
    engine: str = "local",
    workers: int | None = None,
    progress: Progress = silent,
) -> list[Row]:
    """Evaluate every value that is not done; one that fails is a row with its cause, and the next study tries it again.

    Args:
        experiment: with a [study] table; every value is validated before the first one starts.
        study_dir: made if missing; held alone while this runs.
        engine: address of the work engine that each value uses.
        workers: processes of a local engine.
        progress: is told of the values that have ended.

    Returns:
        The rows of study.json.

    Raises:
        BadInput: the study or one of its values is not valid, or another process is at work in the folder.
    """
    trials = list_values(experiment, study_dir)
    publish = partial(_publish, experiment, study_dir)
    trials = run_trials(
        experiment, trials, study_dir, _judged, publish, engine=engine, workers=workers, progress=progress
    )
    return make_rows(study_settings(experiment), trials)


def study_settings(experiment: Experiment) -> StudySettings:
    """The experiment's [study], or BadInput when it has none."""
    if experiment.study is None:
        raise BadInput(f"{experiment.name}: the experiment has no [study] table with `vary` and `values`")
    return experiment.study


def _judged(trial: Trial) -> Trial:
    if not summary_of(trial):
        return trial._replace(status="failed", cause="its evaluation cannot be read")
    return trial._replace(status="done", cause="")


def _publish(experiment: Experiment, study_dir: pathlib.Path, trials: Sequence[Trial]) -> None:
    """Write what is known of the values."""
    settings = study_settings(experiment)
    rows = make_rows(settings, trials)
    told = {name: settings.model_dump(mode="json")[name] for name in ("vary", "curves", "label", "unit", "hold")}
    write_json(study_dir / "study.json", {"name": experiment.name, **told, "rows": rows})
    write_atomic(study_dir / "study.csv", to_csv(rows))
    if curves := to_curves(settings, rows):
        words = sentences(settings, rows)
        write_study_page(study_dir, experiment.name, settings.axis, curves, words, rows, experiment.scene)
