"""Following a given path instead of a policy: what the other planners of a comparison have the robot do.

A path guides by a velocity that depends on time: the path's own, plus a pull back to where the robot should be by then.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from agile_jax.arrays import AnyArray
from agile_jax.geometry import wrap_angle
from agile_jax.scene import POSE_SIZE

PULL = 2.0  # velocity per position error [1/s]


class TimedPath(NamedTuple):
    """Timed poses of one episode; leading axis n for a batch."""

    times: Float[AnyArray, " K"]  # from the begin of the path [s]
    poses: Float[AnyArray, "K 4"]  # [m, rad]
    rates: Float[AnyArray, "K 4"]  # [m/s, rad/s]
    begun: Float[AnyArray, ""]  # when the path began, on the clock of the episode [s]


@runtime_checkable
class PathPlanner(Protocol):
    """Plans on the host for each of n slots."""

    @property
    def paths(self) -> TimedPath:
        """The present path in each slot, leading axis n."""

    def begin(self, slots: Int[np.ndarray, " k"], poses: Float[np.ndarray, "k 4"]) -> None:
        """New episodes in some slots, at rest at poses [m, rad]."""

    def advance(
        self, poses: Float[np.ndarray, "n 4"], times: Float[np.ndarray, " n"], active: Bool[np.ndarray, " n"]
    ) -> None:
        """Before every plan: the measured poses [m, rad], the episodes' clocks [s], and who is running."""


def path_velocity(path: TimedPath, pose: Float[Array, "4"], time: Float[Array, ""]) -> Float[Array, "4"]:
    """Velocity that follows a path from a pose [m, rad] at a time [s]. In [m/s, rad/s]."""
    since = time - path.begun
    wanted = jnp.stack([jnp.interp(since, path.times, path.poses[:, i]) for i in range(POSE_SIZE)])
    rate = jnp.stack([jnp.interp(since, path.times, path.rates[:, i], right=0.0) for i in range(POSE_SIZE)])
    error = wanted - pose
    return rate + PULL * error.at[3].set(wrap_angle(error[3], jnp))


def path_guidance(
    parameters: PyTree,
    path: TimedPath | None,
    pose: Float[Array, "4"],
    velocity: Float[Array, "4"],
    time: Float[Array, ""],
    dt: float,
) -> Float[Array, "4"]:
    """`path_velocity` after the next step: the `reference.Guidance` of a path."""
    assert path is not None, "this guidance follows a path"
    return path_velocity(path, pose + velocity * dt, time + dt)
