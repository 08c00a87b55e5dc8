"""Kinematics and composite inertia of the robot, for one robot; vmap at the caller.

A leg turns by abad angle a about x, then by hip angle h and knee angle k about y:

    foot = hip_pos + Rx(a) ( d e_y + Ry(h) ( -l1 e_z + Ry(k) (-l2 e_z) ) )

with d the abad offset, l1 and l2 the lengths of thigh and calf. The knee bends backward: k < 0.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.robot.model import LEG_COUNT, RobotModel


class LinkPoses(NamedTuple):
    """Frames of the 13 links in the base frame: the trunk, then hip, thigh and calf of each leg."""

    pos: Float[Array, "links 3"]  # [m]
    rotation: Float[Array, "links 3 3"]  # base from link


def _rotation_x(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    c, s, zero, one = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.stack([jnp.stack([one, zero, zero]), jnp.stack([zero, c, -s]), jnp.stack([zero, s, c])])


def _rotation_y(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    c, s, zero, one = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
    return jnp.stack([jnp.stack([c, zero, s]), jnp.stack([zero, one, zero]), jnp.stack([-s, zero, c])])


def link_poses(model: RobotModel, joint_pos: Float[AnyArray, "12"]) -> LinkPoses:
    """Frames of all links at joint positions [rad]."""

    def leg(hip_pos: Float[Array, "3"], offset: Float[Array, ""], angles: Float[Array, "3"]) -> LinkPoses:
        hip_rotation = _rotation_x(angles[0])
        thigh_rotation = hip_rotation @ _rotation_y(angles[1])
        calf_rotation = hip_rotation @ _rotation_y(angles[1] + angles[2])
        thigh_pos = hip_pos + offset * hip_rotation[:, 1]
        calf_pos = thigh_pos - model.thigh_length * thigh_rotation[:, 2]
        return LinkPoses(
            jnp.stack([hip_pos, thigh_pos, calf_pos]), jnp.stack([hip_rotation, thigh_rotation, calf_rotation])
        )

    angles = jnp.reshape(joint_pos, (LEG_COUNT, 3))
    legs = jax.vmap(leg)(jnp.asarray(model.hip_pos_base), jnp.asarray(model.abad_offset), angles)
    pos = jnp.concatenate([jnp.zeros((1, 3)), legs.pos.reshape(-1, 3)])
    rotation = jnp.concatenate([jnp.eye(3)[None], legs.rotation.reshape(-1, 3, 3)])
    return LinkPoses(pos, rotation)


def leg_forward_kinematics(model: RobotModel, joint_pos: Float[AnyArray, "12"]) -> Float[Array, "4 3"]:
    """Centres of the feet in the base frame [m] at joint positions [rad]."""
    poses = link_poses(model, joint_pos)
    return poses.pos[3::3] - model.calf_length * poses.rotation[3::3, :, 2]


def leg_jacobian(model: RobotModel, joint_pos: Float[AnyArray, "12"]) -> Float[Array, "4 3 3"]:
    """Derivative of each foot's centre in the base frame by its own leg's joints.

    Args:
        model: the robot.
        joint_pos: [rad].

    Returns:
        [leg, axis of the base, joint] [m/rad]. Foot velocity = J @ joint velocity.
    """
    poses = link_poses(model, joint_pos)
    foot = poses.pos[3::3] - model.calf_length * poses.rotation[3::3, :, 2]
    axes = jnp.stack([poses.rotation[1::3, :, 0], poses.rotation[2::3, :, 1], poses.rotation[3::3, :, 1]], 1)
    arms = foot[:, None] - jnp.stack([poses.pos[1::3], poses.pos[2::3], poses.pos[3::3]], 1)
    return jnp.swapaxes(jnp.cross(axes, arms), 1, 2)


def leg_inverse_kinematics(model: RobotModel, foot_pos_base: Float[AnyArray, "4 3"]) -> Float[Array, "12"]:
    """Joint positions that put the feet at the given places, with knees bent backward.

    A place out of reach is replaced by the nearest along the leg's own direction, and the angles are clamped to the
    joint limits, so that the result is always finite and allowed.

    Args:
        model: the robot.
        foot_pos_base: centres of the feet [m].

    Returns:
        [rad].
    """
    l1, l2 = model.thigh_length, model.calf_length
    lower, upper = (jnp.reshape(bound, (LEG_COUNT, 3)).T for bound in (model.joint_lower, model.joint_upper))
    x, y, z = (foot_pos_base - model.hip_pos_base).T
    depth = jnp.sqrt(jnp.maximum(y**2 + z**2 - model.abad_offset**2, 0.0))  # below the hip axis, in the leg's plane
    abad = jnp.arctan2(z, y) - jnp.arctan2(-depth, model.abad_offset)
    abad = jnp.mod(abad + jnp.pi, 2 * jnp.pi) - jnp.pi
    cos_knee = (x**2 + depth**2 - l1**2 - l2**2) / (2 * l1 * l2)
    knee = jnp.clip(-jnp.arccos(jnp.clip(cos_knee, -1.0, 1.0)), lower[2], upper[2])
    # The angle of the hip-foot line against straight down, less the same angle at hip = 0.
    hip = jnp.arctan2(-x, depth) - jnp.arctan2(l2 * jnp.sin(knee), l1 + l2 * jnp.cos(knee))
    angles = jnp.stack([abad, hip, knee])
    return jnp.clip(angles, lower, upper).T.reshape(-1)


def composite_inertia(
    model: RobotModel, joint_pos: Float[AnyArray, "12"]
) -> tuple[Float[Array, ""], Float[Array, "3"], Float[Array, "3 3"]]:
    """The whole robot as one rigid body at joint positions [rad].

    Returns:
        Mass [kg]; centre of mass in the base frame [m]; inertia about the centre of mass, along the base's axes
        [kg m^2].
    """
    poses = link_poses(model, joint_pos)
    masses = jnp.asarray(model.link_masses)
    mass = masses.sum()
    coms = poses.pos + jnp.einsum("bij,bj->bi", poses.rotation, model.link_coms)
    com = masses @ coms / mass
    arms = coms - com
    rotated = jnp.einsum("bij,bjk,blk->il", poses.rotation, model.link_inertias, poses.rotation)
    spread = jnp.einsum("b,bi,bi->", masses, arms, arms) * jnp.eye(3) - jnp.einsum("b,bi,bj->ij", masses, arms, arms)
    return mass, com, rotated + spread
