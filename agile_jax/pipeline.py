"""The stages in order, each resumable: `run(experiment, run_dir)`.

Everything is checked before the first byte is written. A finished stage is reused; a killed one goes on where it
stopped.
"""

import pathlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, NamedTuple

from agile_jax.engine import Engine, check_engine, open_engine
from agile_jax.experiment import STAGES, Experiment
from agile_jax.files import check_folder, read_json, remove_torn
from agile_jax.progress import Progress, silent, within
from agile_jax.report import mark_outdated
from agile_jax.run_directory import (
    State,
    locked,
    move_aside,
    refuse_other_settings,
    stage_paths,
    stage_state,
    write_identity,
    write_record,
)

OpenEngine = Callable[[], AbstractContextManager[Engine]]


class StageResult(NamedTuple):
    """What became of a stage."""

    stage: str
    reused: bool  # it was done already
    path: pathlib.Path  # of its summary or report
    summary: dict[str, Any]


def stages_up_to(stage: str) -> tuple[str, ...]:
    """The stage and all that it needs."""
    return STAGES[: STAGES.index(stage) + 1]


def states(experiment: Experiment, run_dir: pathlib.Path, stages: Sequence[str] = STAGES) -> dict[str, State]:
    """What a run would find of each stage; writes nothing."""
    return {stage: stage_state(run_dir, experiment, stage) for stage in stages}


def run(
    experiment: Experiment,
    run_dir: pathlib.Path,
    stages: Sequence[str] = STAGES,
    *,
    engine: str = "local",
    workers: int | None = None,
    overwrite: bool = False,
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
        progress: is told of every work of every stage.

    Raises:
        BadInput: a folder was made with other settings, or another process is at work in the run directory.
        OSError: the disk is full or cannot be written; what is there stays whole.
    """
    check_engine(engine, workers)
    check_folder(run_dir)
    if "evaluation" in stages and (experiment.evaluation.devices > 1 or experiment.evaluation.backend == "mjx-warp"):
        from agile_jax.evaluation import check_devices  # loads JAX

        check_devices(experiment.evaluation)
    if not overwrite:
        refuse_other_settings(run_dir, experiment, tuple(stages))
    results = {}
    with locked(run_dir):
        remove_torn(run_dir)
        write_identity(run_dir, experiment)
        for stage in stages:
            results[stage] = _run_stage(stage, experiment, run_dir, partial(open_engine, engine, workers), progress)
    return results


def failures(results: dict[str, StageResult]) -> list[str]:
    """What went wrong in stages that finished all the same. Episodes that fail are a result, not a failure."""
    if "dataset" not in results:
        return []
    summary = results["dataset"].summary
    found = []
    if summary.get("unverified", 0):
        found.append(f"dataset: {summary['unverified']} trajectories did not pass the independent check")
    if summary.get("attempted") and not summary.get("trajectories"):
        causes = ", ".join(f"{cause}: {count}" for cause, count in summary.get("failed", {}).items())
        found.append(f"dataset: none of {summary['attempted']} starts could be solved ({causes})")
    return found


def _run_stage(
    stage: str, experiment: Experiment, run_dir: pathlib.Path, open_engine: OpenEngine, progress: Progress
) -> StageResult:
    paths = stage_paths(run_dir, experiment, stage)
    state = stage_state(run_dir, experiment, stage)
    if state == "done":
        return StageResult(stage, True, paths.summary, read_json(paths.summary) or {})
    if state == "other settings":
        move_aside(paths.folder)
        if (run_dir / "evaluation").exists():  # of the policy that has just gone
            move_aside(run_dir / "evaluation")
    if stage in ("dataset", "training"):
        write_record(run_dir, experiment, stage)
    else:
        # Their folders hold results of other settings, too: without a record no old result passes for the new one.
        paths.record.unlink(missing_ok=True)

    _WORK[stage](experiment, run_dir, open_engine, within(stage, progress))
    if not paths.summary.is_file():
        raise RuntimeError(f"{stage} ended without {paths.summary}")
    if stage in ("evaluation", "report"):
        write_record(run_dir, experiment, stage)
    mark_outdated(run_dir)  # a report tells of what was there
    return StageResult(stage, False, paths.summary, read_json(paths.summary) or {})


def _dataset(experiment: Experiment, run_dir: pathlib.Path, open_engine: OpenEngine, progress: Progress) -> None:
    from agile_jax.dataset import generate

    generate(
        experiment.scene,
        experiment.expert,
        experiment.dataset,
        experiment.seed,
        run_dir / "dataset",
        open_engine,
        progress,
    )


def _training(experiment: Experiment, run_dir: pathlib.Path, open_engine: OpenEngine, progress: Progress) -> None:
    from agile_jax.training import train

    train(experiment, run_dir, open_engine, progress)


def _evaluation(experiment: Experiment, run_dir: pathlib.Path, open_engine: OpenEngine, progress: Progress) -> None:
    from agile_jax.evaluation.stage import stage

    stage(experiment, run_dir, open_engine, progress)


def _report(experiment: Experiment, run_dir: pathlib.Path, open_engine: OpenEngine, progress: Progress) -> None:
    from agile_jax.report import write_report

    write_report(experiment, run_dir, open_engine, progress)


_WORK: dict[str, Callable[[Experiment, pathlib.Path, OpenEngine, Progress], None]] = {
    "dataset": _dataset,
    "training": _training,
    "evaluation": _evaluation,
    "report": _report,
}
