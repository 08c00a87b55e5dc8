"""When a pose counts as being at the target: the one definition, of the robot's episodes and of the expert's paths."""

from types import ModuleType

import numpy as np
from jaxtyping import Bool, Float

from agile_jax.arrays import AnyArray
from agile_jax.geometry import wrap_angle

PLANAR_TOLERANCE = 0.10  # [m]
HEIGHT_TOLERANCE = 0.05  # [m]
YAW_TOLERANCE = 0.2  # [rad]


def within_tolerance(error: Float[AnyArray, "*batch 4"], xp: ModuleType = np) -> Bool[AnyArray, "*batch"]:
    """Whether poses that differ from the target by `error`, [x, y, z, yaw] [m, rad], count as being there."""
    planar = xp.sqrt(xp.sum(error[..., :2] ** 2, -1))
    return (
        (planar <= PLANAR_TOLERANCE)
        & (xp.abs(error[..., 2]) <= HEIGHT_TOLERANCE)
        & (xp.abs(wrap_angle(error[..., 3], xp)) <= YAW_TOLERANCE)
    )


def arrival_time(
    times: Float[np.ndarray, " n"], poses: Float[np.ndarray, "n 4"], target: Float[np.ndarray, "4"]
) -> float:
    """The first of `times` from which on all poses are within the tolerance of the target [s]; NaN where none is.

    Args:
        times: increasing [s].
        poses: at these times [m, rad].
        target: pose [m, rad].
    """
    outside = np.flatnonzero(~within_tolerance(poses - target))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return float(times[first]) if first < len(times) else float("nan")
