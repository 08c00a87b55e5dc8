"""The stages in order, each resumable: `run(experiment, run_dir)`.

Everything is checked before the first byte is written. A finished stage is reused; a killed one goes on where it
stopped.
"""

import pathlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Literal, NamedTuple

from agile_jax import dataset, evaluation, report, training
from agile_jax.engine import check_engine, open_engine
from agile_jax.experiment import STAGES, Experiment
from agile_jax.files import check_folder, read_json, remove_torn
from agile_jax.progress import Progress, silent, within
from agile_jax.run_directory import (
    State,
    begun_record,
    finish_record,
    locked,
    move_aside,
    refuse_other_settings,
    repair_summary,
    stage_paths,
    stage_state,
    what_differs,
    write_identity,
)
from agile_jax.settings import BadInput
from agile_jax.store.artefact import differences
from agile_jax.store.parts import OpenEngine
from agile_jax.store.record import damaged, read_record, write_record
from agile_jax.store.shared import sharing

Stage = Callable[[Experiment, pathlib.Path, OpenEngine, Progress], object]  # makes what is missing of a stage


class StageResult(NamedTuple):
    """What became of a stage."""

    stage: str
    reused: bool  # it was done already
    path: pathlib.Path  # of its summary or report
    summary: Mapping[str, object]


def stages_for(experiment: Experiment, wanted: Iterable[str]) -> tuple[str, ...]:
    """Some stages and all that they need: to evaluate another planner than the policy needs no stage before it."""
    needed = set()
    for stage in wanted:
        alone = stage == "evaluation" and experiment.evaluation.planner != "policy"
        needed |= {stage} if alone else set(STAGES[: STAGES.index(stage) + 1])
    return tuple(stage for stage in STAGES if stage in needed)


def run(
    experiment: Experiment,
    run_dir: pathlib.Path,
    stages: Sequence[str] = STAGES,
    *,
    engine: str = "local",
    workers: int | None = None,
    overwrite: bool = False,
    store: pathlib.Path | Literal["beside", "none"] = "beside",
    progress: Progress = silent,
) -> dict[str, StageResult]:
    """Run the stages in order, skipping what is done.

    Args:
        experiment: all settings.
        run_dir: made if missing; held alone while this runs.
        stages: of STAGES, in their order.
        engine: address of the work engine: "local", "inline" or "tcp://host:port".
        workers: processes of the local engine; None lets it choose.
        overwrite: move folders that were made with other settings aside, instead of refusing.
        store: folder in which run directories share labels and expert times; "beside": `.store` in the run directory's
            parent folder.
        progress: is told of every work of every stage.

    Raises:
        BadInput: a folder was made with other settings, or another process is at work in the run directory.
        OSError: the disk is full or cannot be written; what is there stays whole.
    """
    check_engine(engine, workers)
    check_folder(run_dir)
    special = experiment.evaluation.backend in ("mjx-warp", "pybullet") or experiment.evaluation.devices > 1
    if "evaluation" in stages and special:
        evaluation.check_backend(experiment)
    if not overwrite:
        refuse_other_settings(run_dir, experiment, tuple(stages))
    folder = {"beside": run_dir.absolute().parent / ".store", "none": None}[store] if isinstance(store, str) else store
    if folder is not None:
        check_folder(folder)
    open_workers, results = partial(open_engine, engine, workers), {}
    with locked(run_dir) as check_held, sharing(folder):
        remove_torn(run_dir)
        write_identity(run_dir, experiment)
        for stage in stages_for(experiment, stages):
            if stage not in stages:
                _check_sound(stage, experiment, run_dir)
        for stage in stages:
            results[stage] = _run_stage(stage, experiment, run_dir, open_workers, check_held, progress)
    return results


def forecast(experiment: Experiment, run_dir: pathlib.Path, stages: Sequence[str] = STAGES) -> dict[str, str]:
    """What a run would keep, make and replace of each stage, in words; writes nothing."""
    return {stage: _intent(stage_state(run_dir, experiment, stage), stage, experiment, run_dir) for stage in stages}


def _intent(state: State, stage: str, experiment: Experiment, run_dir: pathlib.Path) -> str:
    paths = stage_paths(run_dir, experiment, stage)
    record = read_record(paths.record)
    if state == "done":
        return "is done, will be reused"
    if state == "outdated":
        return "is older than what it tells of, will be made anew"
    if state == "other settings":
        reasons = "; ".join(what_differs(run_dir, experiment, stage))
        return f"was made with other settings: will be moved aside and made anew ({reasons})"
    if state == "new":
        old = stage == "evaluation" and paths.summary.exists()
        return f"will be made{f'; {paths.summary.name} will tell of it instead of the last one' if old else ''}"
    if record is not None and record.files is not None and (bad := damaged(run_dir, record.files)):
        return f"is damaged ({', '.join(bad[:3])}{', ...' if len(bad) > 3 else ''}), will be repaired"
    asked = begun_record(run_dir, experiment, stage).amounts
    more = "; ".join(differences(record.amounts, asked)) if record is not None else ""
    return f"was begun, will go on with what is there{f' ({more})' if more else ''}"


def failures(results: dict[str, StageResult]) -> list[str]:
    """What went wrong in stages that finished all the same. Episodes that fail are a result, not a failure."""
    if "dataset" not in results:
        return []
    summary = results["dataset"].summary
    found = []
    if summary.get("unverified", 0):
        found.append(f"dataset: {summary['unverified']} trajectories did not pass the independent check")
    if summary.get("attempted") and not summary.get("trajectories"):
        failed = summary.get("failed")
        causes = ", ".join(f"{cause}: {count}" for cause, count in failed.items()) if isinstance(failed, dict) else ""
        found.append(f"dataset: none of {summary['attempted']} starts could be solved ({causes})")
    return found


def _check_sound(stage: str, experiment: Experiment, run_dir: pathlib.Path) -> None:
    """Refuse (BadInput) to compute from a finished stage that is damaged, where it is not run now."""
    repair_summary(run_dir, experiment, stage)
    record = read_record(stage_paths(run_dir, experiment, stage).record)
    if record is not None and record.files is not None and (bad := damaged(run_dir, record.files)):
        raise BadInput(f"{run_dir}: its {stage} is damaged ({', '.join(bad[:3])}); `agile run {run_dir}` repairs it")


def _run_stage(
    stage: str,
    experiment: Experiment,
    run_dir: pathlib.Path,
    open_engine: OpenEngine,
    check_held: Callable[[], None],
    progress: Progress,
) -> StageResult:
    paths = stage_paths(run_dir, experiment, stage)
    repair_summary(run_dir, experiment, stage)
    state = stage_state(run_dir, experiment, stage)
    if state == "done":
        return StageResult(stage, True, paths.summary, _summary(paths.summary))
    if state == "other settings":
        move_aside(paths.folder)
    write_record(paths.record, begun_record(run_dir, experiment, stage))
    _WORK[stage](experiment, run_dir, open_engine, within(stage, progress))
    check_held()
    if not paths.summary.is_file():
        raise OSError(f"{paths.summary}: is gone; the same command makes it anew")
    finish_record(run_dir, experiment, stage)
    report.mark_outdated(run_dir)  # a report tells of what was there
    return StageResult(stage, False, paths.summary, _summary(paths.summary))


def _summary(path: pathlib.Path) -> Mapping[str, object]:
    return read_json(path) or {} if path.suffix == ".json" else {}


_WORK: dict[str, Stage] = {
    "dataset": lambda e, run_dir, engine, progress: dataset.generate(e, run_dir, engine, progress),
    "training": lambda e, run_dir, engine, progress: training.train(e, run_dir, engine, progress),
    "evaluation": lambda e, run_dir, engine, progress: evaluation.evaluate(e, run_dir, engine, progress),
    "report": lambda e, run_dir, engine, progress: report.write_report(e, run_dir, progress),
}
