"""The poses that a plan may begin and end at: within the bounds, and clear of the obstacles by the margin."""

import numpy as np

from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.space.regions import planning_margin
from agile_jax.scene import POSE_NAMES, POSE_SIZE, Scene, obstacle_clearances
from agile_jax.settings import BadInput

UNITS = ("m", "m", "m", "rad")


def check_start(scene: Scene, settings: ExpertSettings, start: np.ndarray) -> None:
    """Refuse a start pose, shape (4,), from which no plan can begin.

    Raises: BadInput: outside the bounds, inside an obstacle, or within the margin of one. The message names value and
        allowed range.
    """
    _check(scene, settings, start, "start")


def check_target(
    scene: Scene, settings: ExpertSettings, target: np.ndarray | None = None, name: str = "target"
) -> None:
    """Refuse a target pose, shape (4,), at which no plan can end (BadInput, like `check_start`).

    Args:
        scene: obstacles and bounds.
        settings: the margin.
        target: the scene's when not given.
        name: what the message calls it.
    """
    _check(scene, settings, scene.target if target is None else target, name)


def _check(scene: Scene, settings: ExpertSettings, pose: np.ndarray, name: str) -> None:
    pose = np.asarray(pose, float)
    if pose.shape != (POSE_SIZE,) or not np.isfinite(pose).all():
        raise BadInput(f"{name} = {pose.tolist()} must be {POSE_SIZE} finite numbers: x y z yaw [m, m, m, rad]")
    for axis, unit, value, low, high in zip(POSE_NAMES, UNITS, pose, scene.lower, scene.upper, strict=True):
        if not low <= value <= high:
            raise BadInput(f"{name} {axis} = {value:g} {unit} is outside its bounds [{low:g}, {high:g}] {unit}")
    for number, distance in zip(scene.obstacle_numbers, obstacle_clearances(scene, pose), strict=True):
        if distance < planning_margin(settings):
            where = "inside" if distance < 0 else f"{distance:.4f} m from"
            raise BadInput(
                f"{name} = {pose.tolist()} puts the torso {where} obstacle {number} (clearance {distance:.4f} m); "
                f"at least {planning_margin(settings):g} m is needed"
            )
