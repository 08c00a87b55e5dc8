"""The expert's rest-to-rest time from each start: the yardstick of arrival times."""

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np

from agile_jax.engine import Engine, TaskFailure
from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import SceneSettings, make_scene

CHUNK = 16  # starts a task
CHUNK_TIME_LIMIT_S = 120.0  # after which a task counts as hung


def solve_chunk(task: tuple[SceneSettings, ExpertSettings, np.ndarray]) -> tuple[np.ndarray, list[str]]:
    """Durations of a few starts, NaN where the expert found no path, and the branches. Runs in a worker."""
    scene_settings, expert_settings, starts = task
    expert = make_expert(make_scene(scene_settings), expert_settings)
    solutions = [expert.solve(start, initial_velocity="rest") for start in starts]
    durations = np.array([s.duration if s.status == "solved" else np.nan for s in solutions])
    return durations, [s.branch if s.status == "solved" else s.cause for s in solutions]


def expert_times(
    scene: SceneSettings,
    expert: ExpertSettings,
    starts: np.ndarray,
    engine: Callable[[], AbstractContextManager[Engine]],
) -> tuple[np.ndarray, list[str]]:
    """Minimum times from rest at each start to rest at the target, and the routes taken.

    Args:
        scene, expert: settings.
        starts: shape (n, 4) [m, rad].
        engine: opens the work engine.

    Returns:
        Times, shape (n,) [s], NaN where the expert found no path; n branch names.

    Raises:
        RuntimeError: a worker failed for good.
    """
    chunks = [starts[i : i + CHUNK] for i in range(0, len(starts), CHUNK)]
    results: dict[int, tuple[np.ndarray, list[str]]] = {}
    with engine() as workers:
        for index, result in workers.map(solve_chunk, [(scene, expert, chunk) for chunk in chunks], CHUNK_TIME_LIMIT_S):
            if isinstance(result, TaskFailure):
                raise RuntimeError(f"the expert failed on starts {index * CHUNK} and following: {result.cause}")
            results[index] = result
    ordered = [results[index] for index in range(len(chunks))]
    return np.concatenate([times for times, _ in ordered]), [name for _, names in ordered for name in names]
