"""Labels at given poses: what a learner asks the expert while it learns (training/aggregation.py)."""

import pathlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import NamedTuple

import numpy as np

from agile_jax.dataset.expert_time import expert_of
from agile_jax.engine import Engine
from agile_jax.expert import ExpertSettings
from agile_jax.files import hash_json, sha256
from agile_jax.progress import Progress, silent
from agile_jax.scene import SceneSettings
from agile_jax.store.parts import Arrays, complete_parts

CHUNK = 25  # poses a task
CHUNK_TIME_LIMIT_S = 120.0


class Answers(NamedTuple):
    """The expert's paths from n poses to the target, at their best initial velocity."""

    times: np.ndarray  # (n, T+1) [s]
    states: np.ndarray  # (n, T+1, 8) [m, rad, m/s, rad/s]
    asked: int  # poses; from some there may be no path
    digest: str  # hash of the question and of all answers


def answer(task: tuple[SceneSettings, ExpertSettings, np.ndarray]) -> Arrays:
    """Paths from a few poses; the expert verifies each and calls those solved that pass. Runs in a worker."""
    scene, settings, poses = task
    solutions = [expert_of(scene, settings).solve(pose, initial_velocity="free") for pose in poses]
    return {
        "solved": np.array([s.status == "solved" for s in solutions]),
        "times": np.stack([s.trajectory.times for s in solutions]),
        "states": np.stack([s.trajectory.states for s in solutions]),
    }


def ask(
    scene: SceneSettings,
    expert: ExpertSettings,
    poses: np.ndarray,
    engine: Callable[[], AbstractContextManager[Engine]],
    directory: pathlib.Path,
    progress: Progress = silent,
) -> Answers:
    """Solve from each pose, shape (n, 4), with free initial velocity; what is in `directory` already is kept.

    Raises:
        TasksFailedError: a worker failed for good.
    """
    question = [scene.model_dump(mode="json"), expert.model_dump(mode="json")]
    key = hash_json([*question, sha256(np.asarray(poses, float).tobytes())])
    tasks = [(scene, expert, poses[i : i + CHUNK]) for i in range(0, len(poses), CHUNK)]
    arrays, digest = complete_parts(directory, key, answer, tasks, engine, CHUNK_TIME_LIMIT_S, progress)
    if not len(poses):
        return Answers(np.empty((0, 0)), np.empty((0, 0, 8)), 0, digest)
    solved = arrays["solved"]
    return Answers(arrays["times"][solved], arrays["states"][solved], len(poses), digest)
