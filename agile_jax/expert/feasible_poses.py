"""The poses that a plan may begin and end at: within the bounds, and clear of the obstacles by the margin."""

from collections.abc import Sequence

import numpy as np

from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.regions import planning_margin
from agile_jax.scene import POSE_NAMES, POSE_SIZE, PoseLike, Scene, obstacle_clearances, turns_freely
from agile_jax.settings import BadInput, Pose, yaw_error

UNITS = ("m", "m", "m", "rad")


def checked_pose(name: str, values: object) -> np.ndarray:
    """A copy of a pose [m, rad], shape (4,); `name` is what messages call it.

    Raises:
        BadInput: it is not four finite numbers.
    """
    try:
        pose = np.array(values, float)
    except (TypeError, ValueError):
        raise BadInput(f"{name} = {values!r}: must be {POSE_SIZE} numbers, x y z yaw [m, m, m, rad]") from None
    if pose.shape != (POSE_SIZE,) or not np.isfinite(pose).all():
        raise BadInput(f"{name} = {pose.tolist()}: must be {POSE_SIZE} finite numbers, x y z yaw [m, m, m, rad]")
    return pose


def check_start(scene: Scene, settings: ExpertSettings, start: PoseLike) -> None:
    """Refuse a start pose [x, y, z, yaw] [m, rad] from which no plan can begin.

    Raises:
        BadInput: `pose_errors`, one a line.
    """
    if errors := pose_errors(scene, settings, start, "start"):
        raise BadInput("\n".join(errors))


def check_target(scene: Scene, settings: ExpertSettings, target: PoseLike | None = None, name: str = "target") -> None:
    """Refuse a target pose [x, y, z, yaw] [m, rad] at which no plan can end (BadInput, like `check_start`).

    Args:
        scene: its obstacles and bounds count.
        settings: its margin counts.
        target: the scene's when not given.
        name: what the message calls it.
    """
    if errors := pose_errors(scene, settings, scene.target if target is None else target, name):
        raise BadInput("\n".join(errors))


def lowest_underside(scene: Scene, settings: ExpertSettings) -> float:
    """The lowest underside of an obstacle that a plan leads under [m]."""
    return float(scene.lower[2] + scene.torso_half_size[2] + settings.clearance_margin)


def check_targets(scene: Scene, settings: ExpertSettings, targets: Sequence[Pose]) -> None:
    """`check_target` for the scene's target and for each of `targets`, where labels lead to others."""
    check_target(scene, settings)
    for i, target in enumerate(targets):
        check_target(scene, settings, np.array(target), f"dataset.targets[{i}]")


def pose_errors(scene: Scene, settings: ExpertSettings, pose: PoseLike, name: str) -> list[str]:
    """Why no plan can begin or end at a pose: each axis out of bounds, or each obstacle that is too near.

    Where the bounds of yaw hold a full circle, yaw has none. `name` is what the messages call the pose.
    """
    try:
        pose = checked_pose(name, pose)
    except BadInput as refusal:
        return [str(refusal)]
    errors = []
    for axis, unit, value, low, high in zip(POSE_NAMES, UNITS, pose, scene.lower, scene.upper, strict=True):
        if axis == "yaw" and (error := yaw_error(value)):
            errors.append(f"{name} yaw = {value:g} {error}")
        elif not low <= value <= high and not (axis == "yaw" and turns_freely(scene)):
            errors.append(f"{name} {axis} = {value:g} {unit} is outside its bounds [{low:g}, {high:g}] {unit}")
    if errors:
        return errors
    needed = planning_margin(settings)
    distances = obstacle_clearances(scene, pose)
    for number in np.unique(scene.obstacle_numbers):
        distance = distances[scene.obstacle_numbers == number].min()
        if distance < needed:
            where = "inside" if distance < 0 else f"{distance:.4f} m from"
            errors.append(
                f"{name} = {pose.tolist()} puts the torso {where} obstacle {number} (clearance {distance:.4f} m); "
                f"at least {needed:g} m is needed"
            )
    return errors
