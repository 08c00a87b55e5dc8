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
        progress: is told of the episode.

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

    return rollout_one(experiment, run_dir, start, watch, progress) | film


def replay(run_dir: pathlib.Path, file: pathlib.Path, video: pathlib.Path | None = None) -> dict[str, Any]:
    """Look at a recorded episode: `evaluation/<backend>-unstable/episode-N.npz`, or the first of `-traces.npz`.

    Args:
        run_dir: where the experiment's scene and robot stand.
        file: the recording.
        video: film its finite part to this mp4.

    Returns:
        How it went, with units in the names.

    Raises:
        BadInput: no such run or recording.
    """
    import numpy as np

    from agile_jax.evaluation.store import load_traces

    if not run_dir.is_dir():
        raise BadInput(f"{run_dir}: no such run directory; `agile run EXPERIMENT.toml` makes one")
    experiment = load_experiment(run_dir / "experiment.toml")
    trace = load_traces(file)[0]
    finite = np.isfinite(trace.qpos).all(-1) & np.isfinite(trace.qvel).all(-1)
    sound = len(finite) if finite.all() else int(np.argmin(finite))
    shown = type(trace)(*(values[:sound] for values in trace))
    result: dict[str, Any] = {"from_s": float(trace.time[0]), "to_s": float(trace.time[-1])}
    result["first_bad_sample_s"] = None if finite.all() else float(trace.time[sound])
    if sound:
        result |= {
            "last_good_height_m": float(shown.qpos[-1, 2]),
            "largest_speed_m_s": float(np.linalg.norm(shown.qvel[:, :3], axis=-1).max()),
            "largest_joint_speed_rad_s": float(np.abs(shown.qvel[:, 6:]).max()),
            "largest_torque_nm": float(np.nanmax(np.abs(shown.torque))),
            "reference_is_finite": bool(np.isfinite(trace.reference).all()),
        }
    if video is not None:
        if not sound:
            raise BadInput(f"{file}: no sample is finite, so there is nothing to film")
        from agile_jax.report import render_video

        video.parent.mkdir(parents=True, exist_ok=True)
        note = render_video(experiment.scene, experiment.robot, shown, video, experiment.report)
        result |= {"video": str(video)} | ({"video_note": note} if note else {})
    return result
