"""Labels at given poses: what a learner asks the expert while it learns (training/aggregation.py)."""

import pathlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.dataset.expert_time import SolveTask, expert_of, solve_key
from agile_jax.expert import ExpertSettings
from agile_jax.progress import Progress, silent
from agile_jax.scene import SceneSettings
from agile_jax.store.artefact import ANSWERS
from agile_jax.store.parts import Made, OpenEngine, Parts, complete, row_items

CHUNK = 25  # poses a task
CHUNK_TIME_LIMIT_S = 120.0


class Answers(NamedTuple):
    """The expert's paths from n poses to the target, at their best initial velocity."""

    times: Float[np.ndarray, "n nodes"]  # [s]
    states: Float[np.ndarray, "n nodes 8"]  # [m, rad, m/s, rad/s]
    asked: int  # poses; from some there may be no path
    digest: str  # hash of the question and of all answers


def answer(task: SolveTask) -> Made:
    """Paths from a few poses; the expert verifies each and calls those solved that pass. Runs in a worker."""
    scene, settings, poses = task
    solutions = [expert_of(scene, settings).solve(pose, initial_velocity="free") for pose in poses]
    return Made(
        {
            "solved": np.array([s.status == "solved" for s in solutions]),
            "times": np.stack([s.trajectory.times for s in solutions]),
            "states": np.stack([s.trajectory.states for s in solutions]),
        }
    )


def ask(
    scene: SceneSettings,
    expert: ExpertSettings,
    poses: Float[np.ndarray, "n 4"],
    engine: OpenEngine,
    directory: pathlib.Path,
    progress: Progress = silent,
) -> Answers:
    """Solve from each pose [m, rad] with free initial velocity; what is in `directory` already is kept.

    Raises:
        TasksFailedError: a worker failed for good.
    """
    parts = Parts(directory, ANSWERS.name, solve_key(ANSWERS, scene, expert), row_items(poses), CHUNK)
    complete(parts, answer, lambda i: (scene, expert, poses[i]), engine, CHUNK_TIME_LIMIT_S, progress, "answers")
    if not len(poses):
        return Answers(np.empty((0, 0)), np.empty((0, 0, 8)), 0, parts.digest())
    arrays = parts.arrays()
    solved = arrays["solved"]
    return Answers(arrays["times"][solved], arrays["states"][solved], len(poses), parts.digest())
