"""What can be drawn as a path: anything with times and states, as the expert plans it, or times and configurations,
as the physics records it."""

from collections.abc import Mapping
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float

from agile_jax.geometry import quaternion_to_rpy
from agile_jax.scene import POSE_SIZE


@runtime_checkable
class Planned(Protocol):
    """A motion of the planned pose; `expert.Trajectory` is one."""

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Of the states [s]."""

    @property
    def states(self) -> Float[np.ndarray, "n 8"]:
        """Pose and rates [m, rad, m/s, rad/s]."""


@runtime_checkable
class Recorded(Protocol):
    """A motion of the whole robot; `simulation.Trace` is one."""

    @property
    def time(self) -> Float[np.ndarray, " n"]:
        """Of the configurations [s]."""

    @property
    def qpos(self) -> Float[np.ndarray, "n 19"]:
        """Base position [m], quaternion wxyz, joints [rad]."""


Motion: TypeAlias = Planned | Recorded


def timed_poses(motion: Motion) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 4"]]:
    """The times [s] and the poses [x, y, z, yaw] [m, rad] of a motion; those of the trunk where it was recorded."""
    if isinstance(motion, Planned):
        return np.asarray(motion.times, float), np.asarray(motion.states, float)[:, :POSE_SIZE]
    qpos = np.asarray(motion.qpos, float)
    yaw = np.unwrap(quaternion_to_rpy(qpos[:, 3:7])[:, 2])
    return np.asarray(motion.time, float), np.column_stack([qpos[:, :3], yaw])


def by_label(motions: Motion | Mapping[str, Motion]) -> Mapping[str, Motion]:
    """Motions by the label of each; a single one has the label ""."""
    return motions if isinstance(motions, Mapping) else {"": motions}
