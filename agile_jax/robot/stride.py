"""How far a leg can stride, as a function of the trunk's height: what makes a crouching robot slow.

In the plane of a leg, with the hip at height h over the floor, the centre of the foot at (x, r) below it and the knee
bent backward, the lengths of thigh and calf give the angles of both. The further back the foot, the higher the knee:
the thigh rises above the trunk. The further ahead, the lower: the thigh touches the floor. Between these places lies
the window of the foot, [rear(h), front(h)].

A foot that lands d ahead of its hip leaves the ground d - v T duty ahead of it, at speed v and period T of the gait. In
the air it first falls behind further, and before it lands it is ahead of d, both by `overshoot` v T, because its path
begins and ends at rest. So the length of a stride is bounded, v T (duty + 2 overshoot) <= front(h) - rear(h), and with
the shortest period that the legs can swing in, so is the speed.
"""

from types import ModuleType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.arrays import AnyArray
from agile_jax.robot.model import RobotModel

FLOOR_CLEARANCE = 0.05  # that the thighs keep from the floor, over leg length; 10 mm in an A1
LEAST_LIFT = 0.02  # of a step over leg length; 8 mm in an A1
HEIGHT_ERROR = 0.015  # of the trunk that the folded knees leave room for, over leg length; 6 mm in an A1
HEIGHTS, PLACES = 121, 801  # resolution of the table


class StrideTable(NamedTuple):
    """The window of a foot against the height of the trunk."""

    height: Float[np.ndarray, " H"]  # of the base's origin over the floor, increasing [m]
    rear: Float[np.ndarray, " H"]  # smallest x of a standing foot's centre from its hip [m]
    front: Float[np.ndarray, " H"]  # largest [m]


def longest_stride(
    rear: Float[AnyArray, "*heights"],
    front: Float[AnyArray, "*heights"],
    duty: Float[AnyArray, ""] | float,
    xp: ModuleType = np,
) -> Float[AnyArray, "*heights"]:
    """The longest stride v T whose feet stay in a window [m].

    Args:
        rear, front: least and largest x of a foot from its hip [m].
        duty: fraction of the period that a foot stands [-].
        xp: numpy or jax.numpy.
    """
    return xp.maximum(front - rear, 0.0) / (duty + 2 * overshoot(duty, xp))


def overshoot(duty: Float[AnyArray, ""] | float, xp: ModuleType = np) -> Float[AnyArray, ""]:
    """How far a swinging foot passes its landing place, seen from its hip, over the length of a stride.

    The foot's way in the world is the smooth step s^2 (3 - 2 s) of a stride, the hip's is (1 - duty) s of it: the
    largest difference, less `duty`.
    """
    swing = 1 - duty
    s = (1 + xp.sqrt(1 - 2 * swing / 3)) / 2
    return s * s * (3 - 2 * s) - swing * s - duty


def lowest_height(robot: RobotModel) -> float:
    """The lowest trunk whose feet can be lifted under their hips, before the knees reach their limits [m]."""
    length = robot.thigh_length + robot.calf_length
    folded = hip_to_foot(robot, robot.joint_lower[2])
    step = folded + robot.foot_radius + (LEAST_LIFT + HEIGHT_ERROR) * length
    return max(step, robot.shape.trunk_bottom + FLOOR_CLEARANCE * length)


def stride_table(robot: RobotModel) -> StrideTable:
    """The window at heights from the lowest to that of legs that are nearly straight, or as straight as they get."""
    length = robot.thigh_length + robot.calf_length
    straight = 0.98 * hip_to_foot(robot, robot.joint_upper[2])
    heights = np.linspace(lowest_height(robot), straight + robot.foot_radius, HEIGHTS)
    x = np.linspace(-length, length, PLACES)
    allowed = allowed_places(robot, heights[:, None], x)
    front, rear = np.zeros((2, HEIGHTS))
    for i, row in enumerate(allowed):
        inside = np.flatnonzero(row)
        if len(inside):  # the stretch about the place that is nearest to the hip
            first = last = inside[np.argmin(np.abs(x[inside]))]
            gaps = np.flatnonzero(~row)
            first = gaps[gaps < first].max(initial=-1) + 1
            last = gaps[gaps > last].min(initial=PLACES) - 1
            rear[i], front[i] = x[first], x[last]
    return StrideTable(heights, rear, front)


def allowed_places(robot: RobotModel, height: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Whether a foot that stands x ahead of its hip keeps the leg within the trunk's top and its joints [bool]."""
    shape = robot.shape
    thigh, knee = _angles(robot, x, height - robot.foot_radius)
    upper, lower = (robot.joint_upper.reshape(4, 3).min(0), robot.joint_lower.reshape(4, 3).max(0))
    within = np.isfinite(thigh) & (thigh >= lower[1]) & (thigh <= upper[1]) & (knee >= lower[2]) & (knee <= upper[2])
    knee_z = -robot.thigh_length * np.cos(thigh)
    top = np.maximum(_highest(shape.thigh, thigh), knee_z + _highest(shape.calf, thigh + knee))
    lowest = -_highest(shape.thigh * [-1.0, -1.0, 1.0], thigh)
    clearance = FLOOR_CLEARANCE * (robot.thigh_length + robot.calf_length)
    with np.errstate(invalid="ignore"):
        return within & (top <= shape.trunk_top + 1e-9) & (height + lowest >= clearance)


def _angles(robot: RobotModel, x: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles of hip and knee with the foot x ahead of the hip and `depth` below it; NaN out of reach [rad]."""
    l1, l2 = robot.thigh_length, robot.calf_length
    with np.errstate(invalid="ignore"):
        knee = -np.arccos((x**2 + depth**2 - l1**2 - l2**2) / (2 * l1 * l2))
    return np.arctan2(-x, depth) - np.arctan2(l2 * np.sin(knee), l1 + l2 * np.cos(knee)), knee


def _highest(points: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Largest height of round points that turn about y by an angle [m]."""
    x, z, radius = points.T
    return (z * np.cos(angle)[..., None] - x * np.sin(angle)[..., None] + radius).max(-1)


def hip_to_foot(robot: RobotModel, knee: float) -> float:
    """Distance from hip to foot at an angle of the knee [m]."""
    l1, l2 = robot.thigh_length, robot.calf_length
    return float(np.sqrt(l1**2 + l2**2 + 2 * l1 * l2 * np.cos(knee)))
