"""The top speed of a crouching robot: the lower its trunk, the shorter the strides of its legs.

Along x and along y the torso is no faster than V(z) at height z. V is convex and increases: it is the largest of some
straight lines a + b z, each of which is therefore a safe bound by itself, and linear in pose and velocity. The bound is
one of each axis, as those of the velocity are, so that a diagonal motion may be faster by up to sqrt(2).
"""

from types import ModuleType

import numpy as np
from jaxtyping import Float

from agile_jax.arrays import AnyArray
from agile_jax.scene.scene import Scene

PLANAR = (0, 1)  # the axes that have a top speed


def speed_lines(scene: Scene) -> Float[np.ndarray, "lines 2"]:
    """Intercepts a [m/s] and slopes b [1/s] of the lines whose largest is the top speed; none where it has no bound."""
    slopes = np.diff(scene.speed_limits) / np.diff(scene.speed_heights)
    return np.column_stack([scene.speed_limits[:-1] - slopes * scene.speed_heights[:-1], slopes])


def top_speed(
    scene: Scene, height: Float[AnyArray, "*batch"] | float, xp: ModuleType = np
) -> Float[AnyArray, "*batch"]:
    """V(z) [m/s] at heights z [m]; infinity where it has no bound."""
    if len(scene.speed_heights) == 0:
        return xp.full(xp.shape(height), xp.inf)
    intercept, slope = speed_lines(scene).T
    return xp.asarray(xp.maximum((intercept + slope * xp.asarray(height)[..., None]).max(-1), 0.0))


def least_height(scene: Scene, speed: Float[np.ndarray, "*batch"] | float) -> Float[np.ndarray, "*batch"]:
    """The lowest heights [m] at which the torso may have speeds [m/s]; minus infinity where there is no bound."""
    if len(scene.speed_heights) == 0:
        return np.full(np.shape(speed), -np.inf)
    intercept, slope = speed_lines(scene).T
    return np.asarray(((np.asarray(speed)[..., None] - intercept) / slope).min(-1))


def without_top_speed(scene: Scene) -> Scene:
    """The scene in which the robot is as fast at any height."""
    return scene._replace(speed_heights=np.empty(0), speed_limits=np.empty(0))


def within_top_speed(
    scene: Scene, height: Float[AnyArray, "*batch"], velocity: Float[AnyArray, "*batch 4"], xp: ModuleType = np
) -> Float[AnyArray, "*batch 4"]:
    """Velocities [m/s, rad/s] scaled so that they are within the top speed at heights [m]; their directions stay."""
    if len(scene.speed_heights) == 0:
        return velocity
    allowed = top_speed(scene, height, xp)
    fastest = xp.abs(velocity[..., :2]).max(-1)
    return velocity * xp.minimum(1.0, allowed / xp.maximum(fastest, 1e-9))[..., None]
