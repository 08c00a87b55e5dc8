"""What it costs to plan in the plane: the paper's figure 2 over many starts."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.expert.kinds import make_expert
from agile_jax.expert.settings import ExpertSettings
from agile_jax.scene import Scene


class Comparison(NamedTuple):
    """Durations of the same problem with and without a free height, NaN where no path was found."""

    spatial: Float[np.ndarray, " n"]  # in three dimensions [s]
    planar: Float[np.ndarray, " n"]  # in the plane [s]

    @property
    def lost(self) -> Float[np.ndarray, " n"]:
        """Time that planning in the plane loses [s]; NaN where either found no path."""
        return self.planar - self.spatial


def compare_dimensions(scene: Scene, settings: ExpertSettings, starts: Float[np.ndarray, "n 4"]) -> Comparison:
    """Solve every start [m, rad] at the target's height and from rest, in three dimensions and in the plane.

    A start that is free below a table may have no path in the plane: the table is a full box there.

    Raises:
        BadInput: the target is not free in the plane.
    """
    starts = np.array(starts, float)
    starts[:, 2] = scene.target[2]

    def durations(dimensions: Literal["3d", "2d"]) -> np.ndarray:
        expert = make_expert(scene, settings.model_copy(update={"dimensions": dimensions}))
        solutions = [expert.solve(start, initial_velocity="rest") for start in starts]
        return np.array([s.duration if s.status == "solved" else np.nan for s in solutions])

    return Comparison(durations("3d"), durations("2d"))
