"""The expert's rest-to-rest time from each start, and the time at which its path arrives: yardsticks of arrival times.

An episode ends well when the robot stays within a tolerance of the target (scene/tolerance.py), which it enters before
it could reach the target's centre. So it is compared with the time at which the expert's own path enters the same
tolerance for good, as well as with the time of the whole path.
"""

import pathlib
import tempfile
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.expert import Expert, ExpertSettings, ExpertSolution, make_expert
from agile_jax.expert.verify import dense_poses
from agile_jax.progress import Progress, silent
from agile_jax.scene import SceneSettings, arrival_time, make_scene
from agile_jax.store.artefact import EXPERT_TIMES, Artefact, key
from agile_jax.store.parts import Made, OpenEngine, Parts, complete, row_items

CHUNK = 100  # starts a task
CHUNK_TIME_LIMIT_S = 300.0  # after which a task counts as hung
NAME_LENGTH = 480  # of a branch, or of the cause of a failure
NO_PATH_LIMIT = 20.0  # [s]
POINTS = 12  # at which the path is looked at inside each interval

SolveTask = tuple[SceneSettings, ExpertSettings, Float[np.ndarray, "n 4"]]


class ExpertTimes(NamedTuple):
    """The expert's answers for n starts, from rest; NaN where it found no path."""

    duration: Float[np.ndarray, " n"]  # of the path [s]
    arrival: Float[np.ndarray, " n"]  # since when the path stays within the target's tolerance [s]
    branch: list[str]  # the route, or why there is no path


def time_limit(duration: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The time that a follower has where the expert's path takes `duration` [s]; NaN where there is no path."""
    return np.where(np.isfinite(duration), 2 * duration + 3.0, NO_PATH_LIMIT)


def solution_arrival(solution: ExpertSolution, target: Float[np.ndarray, "4"], scheme: str) -> float:
    """Since when a path stays within the target's tolerance [s]; NaN without a path."""
    if solution.status != "solved":
        return float("nan")
    times = solution.trajectory.times
    steps, shares = np.diff(times)[:, None], np.arange(POINTS + 1) / (POINTS + 1)
    dense = np.append((times[:-1, None] + steps * shares).ravel(), times[-1])
    return arrival_time(dense, dense_poses(solution.trajectory, POINTS, scheme), target)


@lru_cache(maxsize=2)
def expert_of(scene: SceneSettings, settings: ExpertSettings) -> Expert:
    """One expert a process: building its solvers takes as long as several solves."""
    return make_expert(make_scene(scene), settings)


def solve_key(artefact: Artefact, scene: SceneSettings, expert: ExpertSettings) -> str:
    """The key of solves from given starts."""
    return key(artefact, {"scene": scene.model_dump(mode="json"), "expert": expert.model_dump(mode="json")})


def solve_times(task: SolveTask) -> Made:
    """The columns of `ExpertTimes` for a few starts. Runs in a worker."""
    scene, settings, starts = task
    target = make_scene(scene).target
    solutions = [expert_of(scene, settings).solve(start, initial_velocity="rest") for start in starts]
    names = [(s.branch if s.status == "solved" else s.cause)[:NAME_LENGTH] for s in solutions]
    columns = {
        "duration": np.array([s.duration if s.status == "solved" else np.nan for s in solutions]),
        "arrival": np.array([solution_arrival(s, target, settings.transcription) for s in solutions]),
        "branch": np.array(names, dtype=f"U{NAME_LENGTH}"),
    }
    return Made(columns)


def expert_times(
    scene: SceneSettings,
    expert: ExpertSettings,
    starts: Float[np.ndarray, "n 4"],
    engine: OpenEngine,
    directory: pathlib.Path | None = None,
    progress: Progress = silent,
) -> ExpertTimes:
    """Minimum times from rest at each start to rest at the target, and the routes taken.

    Args:
        scene, expert: settings.
        starts: poses [m, rad].
        engine: opens the work engine.
        directory: keeps what is solved, so that a killed stage goes on; None keeps nothing.
        progress: is told of every hundred.

    Raises:
        TasksFailedError: a worker failed for good.
    """
    with tempfile.TemporaryDirectory(prefix="agile-times-") as scratch:
        where = pathlib.Path(scratch) if directory is None else directory
        parts = Parts(where, EXPERT_TIMES.name, solve_key(EXPERT_TIMES, scene, expert), row_items(starts), CHUNK)
        limit = CHUNK_TIME_LIMIT_S
        complete(parts, solve_times, lambda i: (scene, expert, starts[i]), engine, limit, progress, "expert times")
        arrays = parts.arrays()
    return ExpertTimes(arrays["duration"], arrays["arrival"], arrays["branch"].tolist())
