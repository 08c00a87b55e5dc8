"""The expert's rest-to-rest time from each start: the yardstick of arrival times."""

import pathlib
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache

import numpy as np

from agile_jax.engine import Engine
from agile_jax.expert import Expert, ExpertSettings, make_expert
from agile_jax.files import hash_json, sha256
from agile_jax.progress import Progress, silent
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.store.parts import Arrays, complete_parts

CHUNK = 100  # starts a task
CHUNK_TIME_LIMIT_S = 300.0  # after which a task counts as hung
NAME_LENGTH = 480  # of a branch, or of the cause of a failure

TimesTask = tuple[SceneSettings, ExpertSettings, np.ndarray]


@lru_cache(maxsize=2)
def expert_of(scene: SceneSettings, settings: ExpertSettings) -> Expert:
    """One expert a process: building its solvers takes as long as several solves."""
    return make_expert(make_scene(scene), settings)


def solve_times(task: TimesTask) -> Arrays:
    """Durations of a few starts, NaN where the expert found no path, and the branches. Runs in a worker."""
    scene, settings, starts = task
    solutions = [expert_of(scene, settings).solve(start, initial_velocity="rest") for start in starts]
    names = [(s.branch if s.status == "solved" else s.cause)[:NAME_LENGTH] for s in solutions]
    return {
        "duration": np.array([s.duration if s.status == "solved" else np.nan for s in solutions]),
        "branch": np.array(names, dtype=f"U{NAME_LENGTH}"),
    }


def expert_times(
    scene: SceneSettings,
    expert: ExpertSettings,
    starts: np.ndarray,
    engine: Callable[[], AbstractContextManager[Engine]],
    directory: pathlib.Path | None = None,
    progress: Progress = silent,
) -> tuple[np.ndarray, list[str]]:
    """Minimum times from rest at each start to rest at the target, and the routes taken.

    Args:
        scene, expert: settings.
        starts: shape (n, 4) [m, rad].
        engine: opens the work engine.
        directory: keeps what is solved, so that a killed stage goes on; None keeps nothing.
        progress: is told of every hundred.

    Returns:
        Times, shape (n,) [s], NaN where the expert found no path; n branch names.

    Raises:
        TasksFailedError: a worker failed for good.
    """
    key = hash_json(
        [scene.model_dump(mode="json"), expert.model_dump(mode="json"), sha256(np.asarray(starts, float).tobytes())]
    )
    tasks = [(scene, expert, starts[i : i + CHUNK]) for i in range(0, len(starts), CHUNK)]
    with tempfile.TemporaryDirectory(prefix="agile-times-") as scratch:
        where = pathlib.Path(scratch) if directory is None else directory
        arrays, _ = complete_parts(where, key, solve_times, tasks, engine, CHUNK_TIME_LIMIT_S, progress)
    return arrays["duration"], arrays["branch"].tolist()
