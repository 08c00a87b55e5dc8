"""The learner's own test: the policy's closed loop (closed_loop.py) from starts that no training has seen.

A light one of few starts looks at the policy every few epochs; the full one after training compares arrival times with
the expert's, and keeps the worst paths for a look at them:

    training/closed_loop.npz    a row for each start; `worst` (k,) rows, `worst_poses` (k, K + 1, 4) their paths
    training/expert-times/      what the expert has answered so far
"""

import io
import pathlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from agile_jax.dataset import expert_times, time_limit, unseen_starts
from agile_jax.engine import Engine
from agile_jax.expert import ExpertSettings
from agile_jax.files import write_atomic
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.progress import Progress, silent
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.training.fit import Watch
from agile_jax.training.kinematic_test.follow import (
    ARRIVED,
    COLLIDED,
    STALLED,
    TIMEOUT,
    Followed,
    Follower,
    make_follower,
)
from agile_jax.training.settings import KinematicTestSettings

TEST_STREAM, WATCH_STREAM, DAGGER_STREAM = 7_002, 7_003, 7_004  # random streams of their own
SHORTEST = 1.0  # [s] of the expert; from nearer starts a ratio of times says nothing
WORST = 12  # paths kept of the least clearance, and as many of the latest
BATCH = 1024  # paths in memory at once


def kinematic_follower(
    policy: Policy, scene: SceneSettings, expert: ExpertSettings, settings: KinematicTestSettings, duration: float
) -> Follower:
    """The closed loop with the settings' tick and head-room; `duration` is the longest time limit [s]."""
    limit = np.array(expert.acceleration) / settings.headroom
    return make_follower(policy, make_scene(scene), duration, settings.dt, limit)


def make_watch(
    policy: Policy,
    scene: SceneSettings,
    expert: ExpertSettings,
    settings: KinematicTestSettings,
    seed: int,
    duration: float,
) -> Watch:
    """The light test: parameters -> rates and the least clearance. Every loop may take `duration` [s]."""
    starts = unseen_starts(scene, expert, settings.watched_starts, (seed, WATCH_STREAM))
    follower = kinematic_follower(policy, scene, expert, settings, duration)

    def watch(parameters: PolicyParameters) -> dict[str, float]:
        followed = follower(parameters, starts, np.full(len(starts), duration))
        found = {
            "field_arrived_rate": followed.rate(ARRIVED),
            "field_collision_rate": followed.rate(COLLIDED),
            "field_stall_rate": followed.rate(STALLED),
        }
        clearance = float(followed.min_clearance.min())
        return found | ({"field_min_clearance_m": clearance} if np.isfinite(clearance) else {})

    return watch


def closed_loop_test(
    policy: Policy,
    parameters: PolicyParameters,
    scene: SceneSettings,
    expert: ExpertSettings,
    settings: KinematicTestSettings,
    seed: int,
    directory: pathlib.Path,
    engine: Callable[[], AbstractContextManager[Engine]],
    progress: Progress = silent,
) -> dict[str, Any]:
    """The full test: writes `closed_loop.npz` in `directory` and returns the `field_*` entries of the summary.

    A loop may take twice the expert's time and three seconds, like an episode of the simulated robot.
    """
    starts = unseen_starts(scene, expert, settings.starts, (seed, TEST_STREAM))
    times, _, branches = expert_times(scene, expert, starts, engine, directory / "expert-times", progress)
    limits = time_limit(times)
    follower = kinematic_follower(policy, scene, expert, settings, float(limits.max()))
    rows: list[Followed] = []
    for first in range(0, len(starts), BATCH):
        part = slice(first, first + BATCH)
        followed = follower(parameters, starts[part], limits[part])
        rows.append(followed._replace(poses=np.empty((len(followed.outcome), 0, 4), np.float32)))
        progress("kinematic test", min(first + BATCH, len(starts)), len(starts))
    whole = Followed(*(np.concatenate(columns) for columns in zip(*rows, strict=True)))
    ratio = whole.arrival_time / times
    worst = worst_rows(whole, ratio)
    columns = {
        "start": starts,
        "expert_time": times,
        "branch": np.array(branches),
        **{name: column for name, column in whole._asdict().items() if name != "poses"},
        "worst": worst,
        "worst_poses": follower(parameters, starts[worst], limits[worst]).poses,
    }
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **columns)
    write_atomic(directory / "closed_loop.npz", buffer.getvalue())
    return summarise(whole, ratio[np.isfinite(ratio) & (times > SHORTEST)], settings)


def worst_rows(followed: Followed, ratio: np.ndarray) -> np.ndarray:
    """Rows of the loops that failed, came nearest to an obstacle, or arrived latest, in this order, each once."""
    count = min(WORST, len(ratio))
    by_clearance = np.argsort(followed.min_clearance, kind="stable")[:count]
    late = np.argsort(-np.where(np.isfinite(ratio), ratio, 0.0), kind="stable")[:count]
    failed = np.flatnonzero(followed.outcome != ARRIVED)[:count]
    return np.array(list(dict.fromkeys([*failed, *by_clearance, *late])), int)


def summarise(followed: Followed, ratios: np.ndarray, settings: KinematicTestSettings) -> dict[str, Any]:
    """Rates over all starts, times over the expert's of those that arrived."""

    def over(values: np.ndarray, quantile: float) -> float | None:
        value = float(np.quantile(values, quantile, method="lower")) if len(values) else np.nan
        return value if np.isfinite(value) else None

    return {
        "field_starts": len(followed.outcome),
        "field_headroom": settings.headroom,
        "field_arrived_rate": followed.rate(ARRIVED),
        "field_collision_rate": followed.rate(COLLIDED),
        "field_stall_rate": followed.rate(STALLED),
        "field_timeout_rate": followed.rate(TIMEOUT),
        "field_time_ratio_median": over(ratios, 0.5),
        "field_time_ratio_p95": over(ratios, 0.95),
        "field_time_ratio_p99": over(ratios, 0.99),
        "field_final_error_m_median": over(followed.final_error, 0.5),
        "field_final_error_m_max": over(followed.final_error, 1.0),
        "field_min_clearance_m_p05": over(followed.min_clearance, 0.05),
        "field_min_clearance_m": over(followed.min_clearance, 0.0),
    }
