"""Published constants of the Unitree A1, each with its source. SI units; legs FR, FL, RR, RL; joints abad, hip, knee.

Sources:
    [1] google-deepmind/mujoco_menagerie, unitree_a1/a1.xml
    [2] unitreerobotics/unitree_ros, robots/a1_description/xacro/const.xacro (the revision that [1] derives from)

robot/a1.xml holds the same numbers; the constants that the package reads from it are compared with these.
"""

from typing import NamedTuple

import numpy as np

FRONT = np.array([1.0, 1.0, -1.0, -1.0])  # (4,) +1 for a front leg
LEFT = np.array([-1.0, 1.0, -1.0, 1.0])  # (4,) +1 for a left leg

# Geometry [m]
HIP_POS_BASE = np.stack([0.183 * FRONT, 0.047 * LEFT, np.zeros(4)], -1)  # (4, 3) abad axis in the trunk's frame [1]
ABAD_OFFSET = 0.08505 * LEFT  # (4,) along y, from the abad axis to the plane of the leg [1]
THIGH_LENGTH = 0.2  # hip to knee [1, 2]
CALF_LENGTH = 0.2  # knee to the foot's centre [1, 2]
FOOT_RADIUS = 0.02  # [1, 2]

# Joints
JOINT_LOWER = np.tile([-0.802851, -1.0472, -2.69653], 4)  # (12,) [rad] [1]; [2] -46, -60, -154.5 degrees
JOINT_UPPER = np.tile([0.802851, 4.18879, -0.916298], 4)  # (12,) [rad] [1]; [2] 46, 240, -52.5 degrees
TORQUE_LIMIT = np.full(12, 33.5)  # [Nm] [1, 2]
JOINT_DAMPING = np.tile([1.0, 2.0, 2.0], 4)  # (12,) [Nm s/rad] [1]
JOINT_ARMATURE = np.full(12, 0.01)  # (12,) reflected inertia of the motor [kg m^2] [1]
JOINT_FRICTION = np.full(12, 0.2)  # (12,) dry friction [Nm] [1]
FOOT_FRICTION = 0.8  # coefficient of sliding friction [1]

# Home posture [1]
HOME_JOINT_POS = np.tile([0.0, 0.9, -1.8], 4)  # (12,) [rad]
NOMINAL_HEIGHT = 0.27  # of the trunk's origin [m]


class LinkConstants(NamedTuple):
    """Mass [kg], centre of mass (3,) [m], inertia about it along the link's axes (xx, yy, zz, xy, xz, yz) [kg m^2]."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]


TRUNK = LinkConstants(
    4.713, (0.0, 0.0041, -0.0005), (0.0158533, 0.0377999, 0.0456542, -3.66e-05, -6.11e-05, -2.75e-05)
)  # [1, 2]

# The front left leg; the others are its mirror images. [1] gives principal axes of the same tensors.
HIP = LinkConstants(
    0.696, (-0.003311, 0.000635, 3.1e-05), (0.000469246, 0.00080749, 0.00055293, -9.409e-06, -3.42e-07, -4.66e-07)
)
THIGH = LinkConstants(
    1.013,
    (-0.003237, -0.022327, -0.027326),
    (0.005529065, 0.005139339, 0.001367788, 4.825e-06, 0.000343869, 2.2448e-05),
)
# Link (0.166 kg at (0.006435, 0, -0.107388)) and foot (0.060 kg, a sphere at (0, 0, -0.2)) as one body, as in [1].
CALF = LinkConstants(
    0.226,
    (0.00472659292, 0.0, -0.131975257),
    (0.00338556645, 0.00340344139, 4.38509375e-05, 0.0, -0.000167427353, 0.0),
)


def mirrored(link: LinkConstants, front: float, left: float) -> LinkConstants:
    """The link mirrored at the planes x = 0 (front = -1) and y = 0 (left = -1)."""
    x, y, z = link.com
    xx, yy, zz, xy, xz, yz = link.inertia
    return LinkConstants(link.mass, (front * x, left * y, z), (xx, yy, zz, front * left * xy, front * xz, left * yz))


def links() -> list[LinkConstants]:
    """The 13 links: the trunk, then hip, thigh and calf of each leg. Only hips differ between front and rear [1]."""
    result = [TRUNK]
    for front, left in zip(FRONT, LEFT, strict=True):
        result += [mirrored(HIP, front, left), mirrored(THIGH, 1.0, left), mirrored(CALF, 1.0, left)]
    return result


class Primitive(NamedTuple):
    """A published collision shape in the frame of its link [m]; a left leg's, mirrored at y = 0 for a right one."""

    source: str
    link: str  # "trunk", or of a leg "hip", "thigh", "calf"
    kind: str  # "box" (half sizes), "capsule" (radius) or "cylinder" (radius)
    size: tuple[float, ...]
    start: tuple[float, float, float]  # a box's centre, or an end of the axis
    end: tuple[float, float, float] | None = None


# [1] as it stands; [2] const.xacro with leg.xacro and robot.xacro; [3] a1.urdf of unitree_ros today, where it differs
# from [2]. Lengths of legs are [1]'s in all: today's URDF has its hips 2.5 mm nearer to the trunk.
PRIMITIVES = (
    Primitive("1", "trunk", "box", (0.125, 0.04, 0.057), (0, 0, 0)),
    Primitive("1", "trunk", "cylinder", (0.058,), (-0.125, -0.04, 0), (0.125, -0.04, 0)),
    Primitive("1", "trunk", "cylinder", (0.058,), (-0.125, 0.04, 0), (0.125, 0.04, 0)),
    Primitive("1", "trunk", "box", (0.005, 0.06, 0.05), (0.25, 0, 0)),
    Primitive("1", "trunk", "capsule", (0.009,), (0.25, 0.06, -0.045), (0.25, 0.06, 0.025)),
    Primitive("1", "trunk", "capsule", (0.009,), (0.25, -0.06, -0.045), (0.25, -0.06, 0.025)),
    Primitive("1", "trunk", "capsule", (0.005,), (0.25, -0.06, -0.05), (0.25, 0.06, -0.05)),
    Primitive("1", "trunk", "capsule", (0.021,), (0.255, -0.052, 0.0355), (0.255, 0.052, 0.0355)),
    Primitive("2", "trunk", "box", (0.1335, 0.097, 0.057), (0, 0, 0)),
    Primitive("3", "trunk", "box", (0.1335, 0.04, 0.057), (0, 0, 0)),
    Primitive("3", "trunk", "cylinder", (0.057,), (-0.1335, -0.04, 0), (0.1335, -0.04, 0)),
    Primitive("3", "trunk", "cylinder", (0.057,), (-0.1335, 0.04, 0), (0.1335, 0.04, 0)),
    Primitive("1", "hip", "cylinder", (0.04,), (0, 0.015, 0), (0, 0.095, 0)),
    Primitive("2", "hip", "cylinder", (0.046,), (0, -0.02, 0), (0, 0.02, 0)),
    Primitive("2", "hip", "cylinder", (0.041,), (0, 0.065, 0), (0, 0.097, 0)),  # the shoulder
    Primitive("1", "thigh", "capsule", (0.015,), (-0.02, 0, 0), (-0.02, 0, -0.16)),
    Primitive("1", "thigh", "capsule", (0.015,), (0, 0, 0), (-0.02, 0, -0.1)),
    Primitive("1", "thigh", "capsule", (0.015,), (-0.02, 0, -0.16), (0, 0, -0.2)),
    Primitive("2", "thigh", "box", (0.017, 0.01225, 0.1), (0, 0, -0.1)),
    Primitive("1", "calf", "capsule", (0.01,), (0, 0, 0), (0.02, 0, -0.13)),
    Primitive("1", "calf", "capsule", (0.01,), (0.02, 0, -0.13), (0, 0, -0.2)),
    Primitive("2", "calf", "box", (0.008, 0.008, 0.1), (0, 0, -0.1)),
    Primitive("1", "calf", "capsule", (0.02,), (0, 0, -0.2), (0, 0, -0.2)),
)
