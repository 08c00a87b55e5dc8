"""Following a given path instead of a policy: what the other planners of a comparison have the robot do.

A path is a field that depends on time: its velocity at that time, plus a pull back to where it should be by then.
"""

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.geometry import wrap_angle
from agile_jax.scene import POSE_SIZE

PULL = 2.0  # velocity per position error [1/s]


class Path(NamedTuple):
    """Timed poses of one episode; leading axis n for a batch."""

    times: Any  # (K,) [s]
    poses: Any  # (K, 4) [m, rad]
    rates: Any  # (K, 4) [m/s, rad/s]
    begun: Any  # () when it began, on the clock of the episode [s]


class PathPlanner(Protocol):
    """Plans on the host for every slot."""

    @property
    def paths(self) -> Path:
        """The present path in each slot, leading axis n."""

    def begin(self, slots: np.ndarray, poses: np.ndarray) -> None:
        """New episodes in `slots`, shape (k,), at rest at poses (k, 4)."""

    def advance(self, poses: np.ndarray, times: np.ndarray, active: np.ndarray) -> None:
        """Before every plan: the measured poses (n, 4), the clocks (n,) [s], and who is running (n,)."""


def path_velocity(path: Path, pose: jax.Array, time: jax.Array) -> jax.Array:
    """Velocity (4,) that follows a path from a pose (4,) at a time [s]."""
    since = time - path.begun
    wanted = jnp.stack([jnp.interp(since, path.times, path.poses[:, i]) for i in range(POSE_SIZE)])
    rate = jnp.stack([jnp.interp(since, path.times, path.rates[:, i], right=0.0) for i in range(POSE_SIZE)])
    error = wanted - pose
    return rate + PULL * error.at[3].set(wrap_angle(error[3], jnp))


def path_command(
    parameters: Any, path: Path, pose: jax.Array, velocity: jax.Array, time: jax.Array, dt: float
) -> jax.Array:
    """`path_velocity` as what a reference follows (reference.Command)."""
    del parameters
    return path_velocity(path, pose + velocity * dt, time + dt)
