"""What the physics tells at every step, and the one definition of a forbidden contact, for both backends."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from agile_jax.arrays import AnyArray
from agile_jax.robot import (
    LEG_NAMES,
    TOUCH_FLOOR_PREFIX,
    TOUCH_FOOT_PREFIX,
    TOUCH_OBSTACLE_PREFIX,
    RobotState,
    robot_state,
)


class Sensed(NamedTuple):
    """State of one robot after a step, and what it touched during it. In a batch, its axis leads.

    Contacts are those of the configuration that the step started from: there both simulators look for them. After a
    reset there were none yet.
    """

    qpos: Float[AnyArray, "19"]  # [m, quaternion wxyz, rad]
    qvel: Float[AnyArray, "18"]  # [m/s in the world, rad/s in the base, rad/s]
    obstacle_contact: Bool[AnyArray, ""]  # some part of the robot touched an obstacle
    floor_contact: Bool[AnyArray, ""]  # trunk, hip or thigh touched the floor
    foot_contact: Bool[AnyArray, "4"]  # what each foot feels

    @property
    def robot_state(self) -> RobotState:
        """What a controller measures."""
        return robot_state(self.qpos, self.qvel, self.foot_contact)


class TouchSlots(NamedTuple):
    """Which entries of a model's sensor data count which contacts."""

    obstacle: Bool[np.ndarray, " nsensordata"]
    floor: Bool[np.ndarray, " nsensordata"]
    feet: Int[np.ndarray, "4"]  # indices instead


def touch_slots(model: mujoco.MjModel) -> TouchSlots:
    """Where a model made by `robot.build_mujoco_model` counts its contacts."""
    obstacle, floor = np.zeros((2, model.nsensordata), bool)
    for index in range(model.nsensor):
        sensor = model.sensor(index)
        slot = int(model.sensor_adr[index])
        obstacle[slot] = sensor.name.startswith(TOUCH_OBSTACLE_PREFIX)
        floor[slot] = sensor.name.startswith(TOUCH_FLOOR_PREFIX)
    feet = [int(model.sensor_adr[model.sensor(TOUCH_FOOT_PREFIX + leg).id]) for leg in LEG_NAMES]
    return TouchSlots(obstacle, floor, np.array(feet))


def contact_flags(
    sensordata: Float[AnyArray, "*batch nsensordata"], slots: TouchSlots
) -> tuple[Bool[AnyArray, "*batch"], Bool[AnyArray, "*batch"], Bool[AnyArray, "*batch 4"]]:
    """Which contacts there are. Two geoms touch when they overlap.

    Args:
        sensordata: number of contacts per sensor.
        slots: of the model.

    Returns:
        obstacle_contact, floor_contact, foot_contact of `Sensed`.
    """
    touching = sensordata > 0
    return (touching & slots.obstacle).any(-1), (touching & slots.floor).any(-1), touching[..., slots.feet]
