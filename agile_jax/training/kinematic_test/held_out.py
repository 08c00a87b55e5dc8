"""The learner's own test: a kinematic robot follows the policy (follow.py) from starts that no training has seen.

A light one of few starts looks at the policy every few epochs; the full one after training compares arrival times with
the expert's, and keeps the worst paths for a look at them:

    training/kinematic_test.npz   a row for each start; `worst` (k,) rows, `worst_poses` (k, K + 1, 4) their paths
    training/expert-times/        what the expert has answered so far
"""

import pathlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from agile_jax.dataset import expert_times, time_limit, unseen_starts
from agile_jax.expert import ExpertSettings
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.progress import Progress, silent
from agile_jax.scene import SceneSettings, make_scene, streams
from agile_jax.store.npz import write_npz
from agile_jax.store.parts import OpenEngine
from agile_jax.training.fit import IntermediateTest
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

SHORTEST = 1.0  # [s] of the expert; from nearer starts a ratio of times says nothing
WORST = 12  # paths kept of the least clearance, and as many of the latest
BATCH = 1024  # paths in memory at once


@dataclass(frozen=True, eq=False)
class KinematicTest:
    """The tests of one policy.

    Attributes:
        policy: what is followed.
        scene_settings: of starts, obstacles and target.
        expert: bounds of the robot, and whose times are compared with.
        settings: tick, head-room, numbers of starts.
        seed: of the starts.
    """

    policy: Policy
    scene_settings: SceneSettings
    expert: ExpertSettings
    settings: KinematicTestSettings
    seed: int

    def starts(self, count: int, *stream: int) -> Float[np.ndarray, "{count} 4"]:
        """Starts [m, rad] of a random stream."""
        return unseen_starts(self.scene_settings, self.expert, count, (self.seed, *stream))

    def follower(self, duration: float) -> Follower:
        """Robots with the settings' tick and head-room; `duration` is the longest time limit [s]."""
        limit = self.expert.limits.acceleration / self.settings.headroom
        return make_follower(self.policy, make_scene(self.scene_settings), duration, self.settings.dt, limit)

    def intermediate(self, duration: float) -> IntermediateTest | None:
        """The light test: rates and the least clearance. Every run may take `duration` [s]."""
        if not self.settings.every:
            return None
        starts = self.starts(self.settings.watched_starts, streams.INTERMEDIATE_TEST_STARTS)
        follower = self.follower(duration)

        def run(parameters: PolicyParameters) -> dict[str, float]:
            followed = follower(parameters, starts, np.full(len(starts), duration))
            clearance = float(followed.min_clearance.min())
            return _rates(followed) | ({"field_min_clearance_m": clearance} if np.isfinite(clearance) else {})

        return IntermediateTest(self.settings.every, run)

    def run(
        self, parameters: PolicyParameters, directory: pathlib.Path, engine: OpenEngine, progress: Progress = silent
    ) -> dict[str, int | float | None]:
        """The full test: writes `kinematic_test.npz` in `directory` and returns the `field_*` entries of the summary.

        A run may take twice the expert's time and three seconds, like an episode of the simulated robot.
        """
        starts = self.starts(self.settings.starts, streams.KINEMATIC_TEST_STARTS)
        times, _, branches = expert_times(
            self.scene_settings, self.expert, starts, engine, directory / "expert-times", progress
        )
        limits = time_limit(times)
        follower = self.follower(float(limits.max()))
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
        write_npz(directory / "kinematic_test.npz", columns)
        return summarise(whole, ratio[np.isfinite(ratio) & (times > SHORTEST)], self.settings)


def worst_rows(followed: Followed, ratio: Float[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """Rows of the runs that failed, came nearest to an obstacle, or arrived latest, in this order, each once.

    `ratio` is each arrival time over the expert's [-], infinite or NaN without one.
    """
    count = min(WORST, len(ratio))
    by_clearance = np.argsort(followed.min_clearance, kind="stable")[:count]
    late = np.argsort(-np.where(np.isfinite(ratio), ratio, 0.0), kind="stable")[:count]
    failed = np.flatnonzero(followed.outcome != ARRIVED)[:count]
    return np.array(list(dict.fromkeys([*failed, *by_clearance, *late])), int)


def _rates(followed: Followed) -> dict[str, float]:
    """What the intermediate and the full test tell."""
    names = {"field_arrived_rate": ARRIVED, "field_collision_rate": COLLIDED, "field_stall_rate": STALLED}
    return {name: followed.rate(outcome) for name, outcome in names.items()}


def summarise(
    followed: Followed, ratios: Float[np.ndarray, " k"], settings: KinematicTestSettings
) -> dict[str, int | float | None]:
    """Rates over all starts; times over the expert's [-] of the k that arrived."""

    def over(values: Float[np.ndarray, " n"], quantile: float) -> float | None:
        value = float(np.quantile(values, quantile, method="lower")) if len(values) else np.nan
        return value if np.isfinite(value) else None

    return {
        "field_starts": len(followed.outcome),
        "field_headroom": settings.headroom,
        **_rates(followed),
        "field_timeout_rate": followed.rate(TIMEOUT),
        "field_time_ratio_median": over(ratios, 0.5),
        "field_time_ratio_p95": over(ratios, 0.95),
        "field_time_ratio_p99": over(ratios, 0.99),
        "field_final_error_m_median": over(followed.final_error, 0.5),
        "field_final_error_m_max": over(followed.final_error, 1.0),
        "field_min_clearance_m_p05": over(followed.min_clearance, 0.05),
        "field_min_clearance_m": over(followed.min_clearance, 0.0),
    }
