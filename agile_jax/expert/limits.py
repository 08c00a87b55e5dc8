"""Bounds of the planned motion, as arrays."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class MotionLimits(NamedTuple):
    """Bounds of the rates and accelerations of the pose [x, y, z, yaw], axis by axis."""

    velocity: Float[np.ndarray, "4"]  # [m/s, rad/s]
    acceleration: Float[np.ndarray, "4"]  # [m/s^2, rad/s^2]
