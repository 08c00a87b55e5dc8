"""What the physics tells at every step, and the one definition of a forbidden contact, for both backends."""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from agile_jax.robot import LEG_NAMES, TOUCH_FLOOR_PREFIX, TOUCH_FOOT_PREFIX, TOUCH_OBSTACLE_PREFIX

Array = Any  # numpy.ndarray or jax.Array


class Sensed(NamedTuple):
    """State of the robot after a step, and what it touched during it. Batch axes, if any, lead.

    Contacts are those of the configuration that the step started from: there both simulators look for them. After a
    reset there were none yet.
    """

    qpos: Array  # (..., 19) [m, quaternion wxyz, rad]
    qvel: Array  # (..., 18) [m/s in the world, rad/s in the base, rad/s]
    obstacle_contact: Array  # (...) bool: some part of the robot touched an obstacle
    floor_contact: Array  # (...) bool: trunk, hip or thigh touched the floor
    foot_contact: Array  # (..., 4) bool: what each foot feels


class TouchSlots(NamedTuple):
    """Which entries of a model's sensor data count which contacts. Masks of shape (nsensordata,)."""

    obstacle: np.ndarray
    floor: np.ndarray
    feet: np.ndarray  # (4,) indices instead


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


def contact_flags(sensordata: Array, slots: TouchSlots) -> tuple[Array, Array, Array]:
    """Which contacts there are. Two geoms touch when they overlap.

    Args:
        sensordata: NumPy or JAX, shape (..., nsensordata): number of contacts per sensor.
        slots: of the model.

    Returns:
        obstacle_contact, floor_contact: shape (...), bool; foot_contact: shape (..., 4), bool.
    """
    touching = sensordata > 0
    return (touching & slots.obstacle).any(-1), (touching & slots.floor).any(-1), touching[..., slots.feet]
