"""How low a robot can walk, and how fast there: `scene.crouch`, worked out from the robot's legs and its gait.

Labels depend on these numbers and on nothing else of robot and gait. So they are rounded, and only those are kept that
can matter: from the lowest height that is planned to the first at which the bounds of the velocity are the lower ones.
"""

import math

import numpy as np

from agile_jax.control.settings import ControlSettings
from agile_jax.experiment.check import Contradiction, ContradictionsError
from agile_jax.robot.settings import RobotSettings
from agile_jax.scene.settings import CrouchSettings, SceneSettings
from agile_jax.settings import BadInput

UNIT = 1000  # a millimetre, and a millimetre per second: heights are rounded up, speeds down

Point = tuple[float, float]  # a height [m] and the top speed there [m/s]


def with_crouch(scene: SceneSettings, fastest: float, robot: RobotSettings, control: ControlSettings) -> SceneSettings:
    """The scene with what the legs allow.

    Args:
        scene: stays as it is where its crouch is given by hand.
        fastest: largest bound of the velocity along x or y [m/s].
        robot: its legs count.
        control: its gait counts.

    Raises:
        ContradictionsError: the robot cannot be used, or `scene.lower` is lower than it can walk.
    """
    if scene.crouch.by == "hand":
        return scene
    from agile_jax.control.top_speed import top_speeds  # loads mujoco

    try:
        legs = top_speeds(robot, control)
    except BadInput as error:
        raise ContradictionsError([Contradiction(("robot", "name"), str(error))]) from None
    least = math.ceil(float(legs.heights[0]) * UNIT) / UNIT
    lowest = scene.lower[2] or least
    if lowest < least:
        told = (
            f"scene.lower = {list(scene.lower)}: the robot's legs cannot walk below z = {least} m; raise it, let "
            'z = 0 stand for that height, or set scene.crouch.by = "hand" and what they can'
        )
        raise ContradictionsError([Contradiction(("scene", "lower"), told)])
    heights, speeds = np.ceil(legs.heights * UNIT) / UNIT, np.floor(legs.speeds * UNIT) / UNIT
    planned = slice(np.searchsorted(heights, lowest, "right"), np.searchsorted(heights, scene.upper[2]) + 1)
    points = [*zip(heights[planned].tolist(), speeds[planned].tolist(), strict=True)]
    slowest = math.floor(float(np.interp(lowest, heights, speeds)) * UNIT) / UNIT
    points.insert(0, (lowest, min(slowest, points[0][1] - 1 / UNIT) if points else slowest))  # it must increase
    last = next((i for i, (_, speed) in enumerate(points) if speed >= fastest), len(points) - 1)
    kept = convex_below(points[: last + 1]) if last else []
    crouch = CrouchSettings(
        lowest=lowest, heights=tuple(height for height, _ in kept), speeds=tuple(speed for _, speed in kept)
    )
    return scene.model_copy(update={"crouch": crouch})


def convex_below(points: list[Point]) -> list[Point]:
    """Those of the points, by increasing height, whose connecting lines are the largest convex function below all."""
    kept: list[Point] = []
    for x, y in points:
        while len(kept) > 1:
            (x0, y0), (x1, y1) = kept[-2:]
            if (y1 - y0) * (x - x1) < (y - y1) * (x1 - x0):
                break
            kept.pop()
        kept.append((x, y))
    return kept
