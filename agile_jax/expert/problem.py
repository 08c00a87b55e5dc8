"""One path that is asked for: what free space, routes, bounds and programs are made for."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.expert.settings import ExpertSettings, InitialVelocity
from agile_jax.scene import Scene


class Problem(NamedTuple):
    """The least time from a start to the scene's target, among the scene's obstacles."""

    scene: Scene
    start: Float[np.ndarray, "4"]  # pose [m, rad]
    initial_velocity: InitialVelocity
    settings: ExpertSettings

    @property
    def target(self) -> Float[np.ndarray, "4"]:
        """The pose to end at, at rest [m, rad]."""
        return self.scene.target

    @property
    def from_rest(self) -> bool:
        """Whether the path begins at rest; else with the best velocity within its bounds."""
        return self.initial_velocity == "rest"
