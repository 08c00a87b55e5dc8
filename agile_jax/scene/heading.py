"""Which way to turn: yaw is an angle, and its bounds say whether it may go round.

Bounds of yaw that hold a full circle are none: every turn is the shorter one, whatever the numbers that name the angle
(from 3.0 to -3.0 rad it is +0.28 rad). Narrower bounds are walls, as those of the position: the turn stays between
them, also where the other way would be shorter, and a measured yaw is read as the angle that lies nearest to their
middle. Planner, field and verification all follow this.
"""

from types import ModuleType

import numpy as np
from jaxtyping import Float

from agile_jax.arrays import AnyArray
from agile_jax.geometry import wrap_angle
from agile_jax.scene.scene import Scene
from agile_jax.scene.settings import POSE_NAMES

YAW = POSE_NAMES.index("yaw")


def turns_freely(scene: Scene) -> bool:
    """Whether the bounds of yaw hold a full circle."""
    return bool(scene.upper[YAW] - scene.lower[YAW] >= 2 * np.pi)


def yaw_between_bounds(
    scene: Scene, yaw: Float[AnyArray, "*batch"] | float, xp: ModuleType = np
) -> Float[AnyArray, "*batch"]:
    """The same angle, within half a turn of the middle between the bounds of yaw [rad]."""
    middle = (scene.lower[YAW] + scene.upper[YAW]) / 2
    return middle + wrap_angle(yaw - middle, xp)


def pose_error(scene: Scene, pose: Float[AnyArray, "*batch 4"], xp: ModuleType = np) -> Float[AnyArray, "*batch 4"]:
    """pose - target, whose yaw is the turn that leads from the target to the pose [m, rad]."""
    target = xp.asarray(scene.target)
    error = pose - target
    if turns_freely(scene):
        turn = wrap_angle(error[..., YAW], xp)
    else:
        turn = yaw_between_bounds(scene, pose[..., YAW], xp) - target[YAW]
    return xp.concatenate([error[..., :YAW], turn[..., None]], -1)


def facing(scene: Scene, start: Float[np.ndarray, "4"]) -> Scene:
    """The scene with the number for the target's yaw that a path from the pose `start` ends with.

    Where the yaw may go round, it is the nearest to the start's, and the bounds include both; else nothing changes.
    """
    if not turns_freely(scene) or not np.isfinite(start[YAW]):
        return scene
    turns = np.round((start[YAW] - scene.target[YAW]) / (2 * np.pi))
    ends = start[YAW], scene.target[YAW]
    if turns == 0 and scene.lower[YAW] <= min(ends) and max(ends) <= scene.upper[YAW]:
        return scene
    target, lower, upper = scene.target.copy(), scene.lower.copy(), scene.upper.copy()
    target[YAW] += 2 * np.pi * turns
    lower[YAW], upper[YAW] = min(lower[YAW], target[YAW], start[YAW]), max(upper[YAW], target[YAW], start[YAW])
    return scene._replace(target=target, lower=lower, upper=upper)
