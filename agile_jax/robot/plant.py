"""The simulated robot where it is not the one that the controller knows: other joints, masses, friction and motors.

`PlantSettings` say how; each episode draws from their ranges, from a random stream of its own.
"""

import copy
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from agile_jax.robot.settings import PlantSettings

TRUNK_BODY = 1  # body 0 is the world


class Plant(NamedTuple):
    """What robots are, against their file. Leading axis n in a batch."""

    joint_damping: Float[np.ndarray, "*n"]  # factor
    joint_friction: Float[np.ndarray, "*n"]  # factor
    armature: Float[np.ndarray, "*n"]  # factor
    mass: Float[np.ndarray, "*n"]  # factor on the trunk's
    com_shift: Float[np.ndarray, "*n 3"]  # of the trunk [m]
    foot_friction: Float[np.ndarray, "*n"]  # coefficient; NaN: the file's
    delay: Float[np.ndarray, "*n"]  # of the torques [s]
    no_load_speed: Float[np.ndarray, "*n"]  # of the motors [rad/s]; infinity: the limit holds at every speed
    push: Float[np.ndarray, "*n 2"]  # impulse of one push on the trunk, in the plane of the world [N s]
    push_after: Float[np.ndarray, "*n"]  # when it comes to who has not been below an obstacle [s]

    def of(self, robots: Int[np.ndarray, " k"] | int) -> "Plant":
        """Some of the batch, or one."""
        return Plant(*(values[robots] for values in self))


def draw_plants(settings: PlantSettings, stream: tuple[int, ...], episodes: Int[np.ndarray, " n"]) -> Plant:
    """The robots of episodes: what an episode draws depends on its number and the stream alone."""
    ranges = [settings.joint_damping, settings.joint_friction, settings.armature, settings.mass, *settings.com_shift]
    ranges += [np.nan if settings.foot_friction is None else settings.foot_friction, settings.delay]
    ranges += [np.inf if settings.no_load_speed is None else settings.no_load_speed]
    ranges += [settings.push_impulse, (0.0, 2 * np.pi)]
    columns = np.zeros((len(ranges), len(episodes)))
    for i, episode in enumerate(episodes.tolist()):
        shares = np.random.default_rng((*stream, episode)).uniform(size=len(ranges))
        for k, (value, share) in enumerate(zip(ranges, shares, strict=True)):
            columns[k, i] = value[0] + share * (value[1] - value[0]) if isinstance(value, tuple) else value
    damping, friction, armature, mass, *shift, foot_friction, delay, no_load_speed, impulse, angle = columns
    push = impulse[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    never = np.full(len(episodes), np.inf)
    return Plant(
        damping, friction, armature, mass, np.stack(shift, -1), foot_friction, delay, no_load_speed, push, never
    )


def plant_model(model: mujoco.MjModel, plant: Plant) -> mujoco.MjModel:
    """A copy of a model made by `build_mujoco_model`, of one robot as `plant` says."""
    changed = copy.copy(model)
    changed.dof_damping[6:] *= plant.joint_damping
    changed.dof_frictionloss[6:] *= plant.joint_friction
    changed.dof_armature[6:] *= plant.armature
    changed.body_mass[TRUNK_BODY] *= plant.mass
    changed.body_inertia[TRUNK_BODY] *= plant.mass
    changed.body_ipos[TRUNK_BODY] += plant.com_shift
    if np.isfinite(plant.foot_friction):
        changed.geom_friction[model.geom_priority > 0, 0] = plant.foot_friction
    mujoco.mj_setConst(changed, mujoco.MjData(changed))
    return changed


def available_torque(
    torque: Float[np.ndarray, "n 12"],
    joint_vel: Float[np.ndarray, "n 12"],
    limit: Float[np.ndarray, "12"],
    no_load_speed: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 12"]:
    """The torques that motors give at joint speeds [rad/s]: a motor that brakes gives all that is asked of it [Nm]."""
    share = np.clip(2 * (1 - np.abs(joint_vel) / no_load_speed[:, None]), 0.0, 1.0)
    drives = torque * joint_vel > 0
    return np.where(drives, np.clip(torque, -share * limit, share * limit), torque)
