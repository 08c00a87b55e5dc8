"""What it costs to plan in the plane: the paper's figure 2 over many starts."""

from typing import NamedTuple

import numpy as np

from agile_jax.expert.expert import make_expert
from agile_jax.expert.settings import ExpertSettings
from agile_jax.scene import Scene


class Comparison(NamedTuple):
    """Durations of the same problem with and without a free height, NaN where a planner found no path. Shape (n,)."""

    spatial: np.ndarray  # planner "3d" [s]
    planar: np.ndarray  # planner "2d" [s]

    @property
    def lost(self) -> np.ndarray:
        """Time that planning in the plane loses [s]; NaN where either found no path."""
        return self.planar - self.spatial


def compare_planners(scene: Scene, settings: ExpertSettings, starts: np.ndarray) -> Comparison:
    """Solve every start, shape (n, 4), at the target's height and from rest, with both planners.

    A start that is free below a table may have no path in the plane: the table is a full box there.

    Raises:
        BadInput: the target is not free in the plane.
    """
    starts = np.array(starts, float)
    starts[:, 2] = scene.target[2]
    durations = []
    for planner in ("3d", "2d"):
        expert = make_expert(scene, settings.model_copy(update={"dimensions": planner}))
        solutions = [expert.solve(start, initial_velocity="rest") for start in starts]
        durations.append(np.array([s.duration if s.status == "solved" else np.nan for s in solutions]))
    return Comparison(*durations)
