"""How low a robot can walk, and how fast at each height: the strides of its legs in the shortest period of its gait."""

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.control.scaling import scaled_to
from agile_jax.control.settings import ControlSettings
from agile_jax.robot import RobotSettings, load_robot, longest_stride, stride_table
from agile_jax.robot.settings import OWN


class TopSpeeds(NamedTuple):
    """Of a trot, from the lowest height at which the robot can walk."""

    heights: Float[np.ndarray, " n"]  # increasing [m]
    speeds: Float[np.ndarray, " n"]  # never decreasing [m/s]


def top_speeds(robot: RobotSettings, settings: ControlSettings) -> TopSpeeds:
    """What the legs of a robot allow with the settings' gait.

    Raises:
        BadInput: the robot's file cannot be used.
    """
    # The file of another robot may have changed.
    return _own(settings) if robot.name == OWN else _top_speeds(robot, settings)


@functools.lru_cache(maxsize=16)
def _own(settings: ControlSettings) -> TopSpeeds:
    return _top_speeds(RobotSettings(), settings)


def _top_speeds(robot: RobotSettings, settings: ControlSettings) -> TopSpeeds:
    model = load_robot(robot)
    gait, table = scaled_to(model, settings).gait, stride_table(model)
    speeds = np.maximum.accumulate(longest_stride(table.rear, table.front, gait.duty)) / gait.shortest_period
    return TopSpeeds(table.height[speeds > 0], speeds[speeds > 0])
