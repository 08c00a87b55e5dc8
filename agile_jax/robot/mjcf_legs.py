"""The legs of a compiled MJCF: their joints, feet and torque limits, and what makes a file unusable."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from agile_jax.robot.settings import RobotSettings
from agile_jax.settings import BadInput

STRAIGHT = 5e-3  # how far hip, knee and foot of a leg at zero angles may be from one vertical line [m]


class Leg(NamedTuple):
    """One leg of the source model; joints abad, hip, knee."""

    joints: list[int]
    signs: Float[np.ndarray, "3"]  # of their axes against +x, +y, +y
    foot: int  # geom


def leg_joints(source: mujoco.MjModel, settings: RobotSettings, leg: str) -> list[int]:
    """Abad, hip and knee of one leg, each below the one before."""
    names = [pattern.format(leg=leg) for pattern in settings.joints]
    joints = [mujoco.mj_name2id(source, mujoco.mjtObj.mjOBJ_JOINT, name) for name in names]
    missing = [name for name, joint in zip(names, joints, strict=True) if joint < 0]
    if missing:
        there = [source.joint(i).name for i in range(source.njnt)]
        raise BadInput(f"has no joint {', '.join(missing)}; it has {', '.join(there)}. Set robot.legs and robot.joints")
    bodies = [int(source.jnt_bodyid[joint]) for joint in joints]
    for k in (1, 2):
        if bodies[k] == bodies[k - 1] or not _is_below(source, bodies[k], bodies[k - 1]):
            raise BadInput(f"joint {names[k]} is not below {names[k - 1]} in the tree")
    below = [i for i in range(source.njnt) if _is_below(source, int(source.jnt_bodyid[i]), bodies[0])]
    if len(below) != 3:
        found = ", ".join(source.joint(i).name for i in below)
        raise BadInput(f"leg {leg} has {len(below)} joints ({found}); it must have 3")
    return joints


def read_leg(source: mujoco.MjModel, data: mujoco.MjData, leg: str, joints: list[int]) -> Leg:
    """The leg with its axes and foot, at the configuration of `data`: all angles zero, the trunk level."""
    names = [source.joint(joint).name for joint in joints]
    signs = []
    for joint, name, axis in zip(joints, names, np.array([[1, 0, 0], [0, 1, 0], [0, 1, 0]]), strict=True):
        along = float(data.xaxis[joint] @ axis)
        if source.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE or abs(along) < 0.999:
            raise BadInput(
                f"joint {name} must be a hinge about {'x' if axis[0] else 'y'}; its axis is {data.xaxis[joint]}"
            )
        signs.append(np.sign(along))
    return Leg(joints, np.array(signs), _foot(source, data, int(source.jnt_bodyid[joints[2]]), leg))


def _foot(source: mujoco.MjModel, data: mujoco.MjData, calf: int, leg: str) -> int:
    """The lowest sphere at the calf that collides."""
    spheres = [
        i
        for i in range(source.ngeom)
        if source.geom_type[i] == mujoco.mjtGeom.mjGEOM_SPHERE
        and (source.geom_contype[i] or source.geom_conaffinity[i])
        and _is_below(source, int(source.geom_bodyid[i]), calf)
    ]
    if not spheres:
        raise BadInput(f"leg {leg} has no foot: no sphere that collides at its calf")
    return min(spheres, key=lambda i: data.geom_xpos[i, 2])


def trunk_body(source: mujoco.MjModel, legs: list[list[int]]) -> int:
    """The body that carries the legs, with the one joint that is no leg's."""
    parents = {int(source.body_parentid[source.jnt_bodyid[joints[0]]]) for joints in legs}
    trunk = parents.pop()
    if parents:
        raise BadInput("its legs hang on different bodies")
    free = source.body_jntnum[trunk] == 1 and source.jnt_type[source.body_jntadr[trunk]] == mujoco.mjtJoint.mjJNT_FREE
    if not free:
        raise BadInput(f"its trunk {source.body(trunk).name!r} has no free joint")
    if source.njnt != 13:
        known = {joint for joints in legs for joint in joints} | {int(source.body_jntadr[trunk])}
        others = [source.joint(i).name for i in range(source.njnt) if i not in known]
        raise BadInput(f"it has joints besides its legs': {', '.join(others)}")
    return trunk


def joint_places(data: mujoco.MjData, leg: Leg, foot: Float[np.ndarray, "3"]) -> list[Float[np.ndarray, "3"]]:
    """Origins of the leg's links, each moved along its joint's axis into the plane of the foot or above it."""
    abad, hip, knee = data.xanchor[leg.joints]
    return [
        np.array([hip[0], abad[1], abad[2]]),
        np.array([hip[0], foot[1], hip[2]]),
        np.array([knee[0], foot[1], knee[2]]),
    ]


def check_straight(data: mujoco.MjData, name: str, leg: Leg) -> None:
    """Refuse a leg that does not hang straight down at zero angles."""
    foot = data.geom_xpos[leg.foot]
    abad, hip, knee = joint_places(data, leg, foot)
    off = max(abs(hip[2] - abad[2]), abs(knee[0] - hip[0]), abs(foot[0] - knee[0]))
    if off > STRAIGHT or not hip[2] > knee[2] > foot[2]:
        raise BadInput(
            f"leg {name} does not hang straight down at zero angles: hip, knee and foot are at "
            f"{hip.round(3)}, {knee.round(3)}, {foot.round(3)} m"
        )


def torque_limit(source: mujoco.MjModel, joint: int) -> float:
    """The smallest limit that the file gives [Nm]."""
    limits = [source.jnt_actfrcrange[joint]] if source.jnt_actfrclimited[joint] else []
    for i in range(source.nu):
        if source.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and source.actuator_trnid[i, 0] == joint:
            gear = abs(source.actuator_gear[i, 0])
            if source.actuator_forcelimited[i]:
                limits.append(gear * source.actuator_forcerange[i])
            direct = source.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_NONE
            if direct and source.actuator_ctrllimited[i]:
                limits.append(gear * source.actuator_gainprm[i, 0] * source.actuator_ctrlrange[i])
    limit = min((float(np.abs(pair).min()) for pair in limits), default=0.0)
    if limit <= 0:
        raise BadInput(f"joint {source.joint(joint).name} has no torque limit: no motor with a ctrlrange or forcerange")
    return limit


def _is_below(source: mujoco.MjModel, body: int, ancestor: int) -> bool:
    while body > 0 and body != ancestor:
        body = int(source.body_parentid[body])
    return body == ancestor
