"""One closed-loop episode, for looking at."""

import pathlib
from collections.abc import Sequence

import numpy as np

from agile_jax.dataset import time_limit
from agile_jax.evaluation.backend import command_parameters, make_backend, on_one_blas_thread
from agile_jax.experiment import Experiment
from agile_jax.expert import check_start, make_expert
from agile_jax.progress import Progress, silent
from agile_jax.scene import make_scene
from agile_jax.simulation import OUTCOME_NAMES, Recorder, Trace, gather, push_after, stream


@on_one_blas_thread
def rollout_one(
    experiment: Experiment,
    run_directory: pathlib.Path,
    start: Sequence[float] | np.ndarray,
    progress: Progress = silent,
) -> tuple[Trace, dict[str, object]]:
    """Run one episode in C MuJoCo.

    Args:
        experiment: settings.
        run_directory: holds `training/`.
        start: pose [x, y, z, yaw] [m, rad].
        progress: is told of the one episode.

    Returns:
        The recorded motion; outcome, times and quality, with units in the names.

    Raises:
        BadInput: the start is inside an obstacle or out of bounds.
    """
    scene = make_scene(experiment.scene)
    pose = np.array(start, float)
    check_start(scene, experiment.expert, pose)
    solution = make_expert(scene, experiment.expert).solve(pose, initial_velocity="rest")
    expert_time = solution.duration if solution.status == "solved" else np.nan
    limits = time_limit(np.array([expert_time]))
    backend = make_backend(experiment, command_parameters(experiment, run_directory / "training"), 1, 1)
    recorder = Recorder(backend.slots, 1)

    def record(holds: np.ndarray) -> None:
        recorder(holds)
        progress("episode", 0, 1)

    first = np.zeros(1, int)
    plant = backend.plants(first, push_after(np.array([expert_time]), [solution.branch]))
    steps = stream(backend.slots, backend.qpos(pose[None]), limits, record, plant, backend.keys(first))
    rollout = gather(1, steps)
    outcome, trace = rollout.outcome, recorder.traces(scene, backend.plan_dt)[0]
    name = OUTCOME_NAMES[int(outcome.status[0])]
    return trace, {
        "outcome": name,
        "arrival_time_s": float(outcome.inside_since[0]) if name == "success" else None,
        "expert_time_s": float(expert_time) if np.isfinite(expert_time) else None,
        "end_time_s": float(outcome.time[0]),
        "min_clearance_m": float(outcome.min_clearance[0]),
        "min_self_clearance_m": float(outcome.min_self_clearance[0]),
        "final_error_m": float(outcome.planar_error[0]),
        "lowest_trunk_height_m": float(trace.qpos[:, 2].min()),
        **{key: int(values[0]) for key, values in rollout.counts._asdict().items()},
    }
