"""One closed-loop episode of a finished run, and its film."""

import pathlib
from collections.abc import Sequence
from typing import Any

from agile_jax.experiment import load_experiment
from agile_jax.progress import Progress, silent
from agile_jax.run_directory import stage_state
from agile_jax.settings import BadInput


def rollout(
    run_dir: pathlib.Path, start: Sequence[float], video: pathlib.Path | None = None, progress: Progress = silent
) -> dict[str, Any]:
    """Let the robot run from a pose with the policy of a run directory.

    Args:
        run_dir: with a finished training.
        start: pose [x, y, z, yaw] [m, rad].
        video: film the episode to this mp4.
        progress: called with (done, total, note).

    Returns:
        Outcome, times and quality, with units in the names; `video` and `video_note` when it was filmed.

    Raises:
        BadInput: no finished training there, or the start is outside the bounds or too near to an obstacle.
    """
    if not run_dir.is_dir():
        raise BadInput(f"{run_dir}: no such run directory; `agile run EXPERIMENT.toml` makes one")
    experiment = load_experiment(run_dir / "experiment.toml")
    if stage_state(run_dir, experiment, "training") != "done":
        raise BadInput(f"{run_dir}: its training is not finished; `agile train {run_dir / 'experiment.toml'}` first")
    from agile_jax.evaluation.single import rollout_one

    film: dict[str, Any] = {}

    def watch(trace: Any) -> None:
        if video is None:
            return
        from agile_jax.report import render_video

        video.parent.mkdir(parents=True, exist_ok=True)
        note = render_video(experiment.scene, experiment.robot, trace, video, experiment.report)
        film.update({"video": str(video)} | ({"video_note": note} if note else {}))

    def named(done: int, total: int, note: str) -> None:
        progress(done, total, f"rollout: {note}")

    return rollout_one(experiment, run_dir, start, watch, named) | film
