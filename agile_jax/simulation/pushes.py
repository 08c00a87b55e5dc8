"""One push on the trunk of each of n robots, in its crouch where it has one.

The push comes at the first plan at which a part of the torso's envelope is below an obstacle; at the latest at the
robot's `push_after`. It is a constant horizontal force through the trunk's centre of mass, for 50 ms.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from agile_jax.robot import Plant
from agile_jax.scene import Scene, obstacle_clearances, planar_scene

PUSH_DURATION = 0.05  # [s]


def below_obstacle(scene: Scene, pose: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, " n"]:
    """Whether a part of the torso's envelope at each pose [m, rad] is within the outline of an obstacle above it."""
    undersides = scene.obstacle_centers[:, 2] - scene.obstacle_half_sizes[:, 2]
    within = np.asarray(obstacle_clearances(planar_scene(scene), pose)) < 0  # there obstacles stand on the floor
    return (within & (pose[:, 2:3] <= undersides)).any(-1)


def push_after(expert_time: Float[np.ndarray, " n"], branch: Sequence[str]) -> Float[np.ndarray, " n"]:
    """When robots are pushed that have not been below an obstacle: at half the expert's time [s].

    Infinity where the expert's path goes under an obstacle, so that its follower is pushed there or not at all; and
    where the expert has no path.
    """
    under = np.array(["under" in name.split("+") for name in branch], bool)
    return np.where(under | ~np.isfinite(expert_time), np.inf, expert_time / 2)


class Pushes:
    """Who of n robots is pushed now; nobody, until `reset` tells of impulses."""

    def __init__(self, scene: Scene, batch: int, dt: float) -> None:
        """Args: scene: of the obstacles; batch: n; dt: between two torques [s]."""
        self._scene, self._steps = scene, max(1, round(PUSH_DURATION / dt))
        self._dt = dt
        self._force = np.zeros((batch, 3))  # while it acts, in the world [N]
        self._after = np.full(batch, np.inf)  # [s]
        self._waiting = np.zeros(batch, bool)
        self._left = np.zeros(batch, int)  # torques until the end of a push that has begun

    def reset(self, robots: Int[np.ndarray, " k"], plants: Plant | None) -> None:
        """Some robots begin anew; `plants` has leading axis k, with None nobody is pushed."""
        self._left[robots] = 0
        self._force[robots] = 0.0
        if plants is not None:
            self._force[robots, :2] = plants.push / (self._steps * self._dt)
            self._after[robots] = plants.push_after
        self._waiting[robots] = self._force[robots].any(-1)

    @property
    def waiting(self) -> bool:
        """Whether there is somebody still to be pushed."""
        return bool(self._waiting.any())

    def plan(
        self, pose: Float[np.ndarray, "n 4"], time: Float[np.ndarray, " n"], active: Bool[np.ndarray, " n"]
    ) -> None:
        """Begin the pushes that are due, at a plan; from the trunks' poses [m, rad] and the episodes' times [s]."""
        due = self._waiting & active & (below_obstacle(self._scene, pose) | (time >= self._after))
        self._waiting[due], self._left[due] = False, self._steps

    def forces(self, active: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"] | None:
        """Until the next torque, in the world [N]; None when nobody is pushed."""
        pushed = (self._left > 0) & active
        if not pushed.any():
            return None
        self._left[pushed] -= 1
        return np.where(pushed[:, None], self._force, 0.0)
