"""Joint torques from foot forces and swing paths.

A standing leg applies -J' f, the reaction of the planned ground force. A swinging leg follows its path by joint PD.
Both get the torque that holds the legs' weight and the torque that the joints' own damping and friction would eat:
left out, they are as large as the planned torques themselves (2 Nm s/rad at 4 rad/s). A standing leg gets it for the
velocity that is planned: for the measured one it would be positive feedback, and negative damping where the joints have
less than is believed. In a swinging leg the joint feedback is damping enough.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from agile_jax.arrays import AnyArray
from agile_jax.control.joint_model import passive_torque
from agile_jax.control.settings import ControlSettings
from agile_jax.control.swing import swing_path
from agile_jax.geometry import inverse_3x3
from agile_jax.robot import (
    GRAVITY,
    RobotModel,
    RobotState,
    composite_inertia,
    leg_forward_kinematics,
    leg_inverse_kinematics,
    leg_jacobian,
    link_poses,
)

JACOBIAN_DAMPING = 0.02  # of the inverse near a stretched leg [m/rad]

# Of the guard before the joints' limits: how far it looks ahead [s], where it begins [rad], stiffness over the swing's.
GUARD_TIME, GUARD_MARGIN, GUARD_STIFFNESS = 0.01, 0.02, 5.0


class SwingTarget(NamedTuple):
    """Paths of the four feet; those of standing feet are not used."""

    lift_off_world: Float[Array, "4 3"]  # [m]
    foothold_world: Float[Array, "4 3"]  # [m]
    step_height: Float[Array, ""]  # [m]
    progress: Float[Array, "4"]  # in [0, 1]
    duration: Float[Array, ""]  # [s]
    depth: Float[Array, "4"]  # that much below the path [m]
    descent: Float[Array, "4"]  # that fast down [m/s]
    fall: Float[Array, "4"]  # and that fast faster [m/s^2]


def gravity_torque(
    robot: RobotModel, joint_pos: Float[Array, "12"], R_world_base: Float[Array, "3 3"]
) -> Float[Array, "12"]:
    """Torque that holds the legs' weight with the trunk held: the gradient of potential energy [Nm]."""
    up_base = R_world_base[2]

    def energy(q: jax.Array) -> jax.Array:
        mass, center, _ = composite_inertia(robot, q)
        return mass * GRAVITY * jnp.dot(up_base, center)

    return jax.grad(energy)(joint_pos)


def stance_torque(jacobian: Float[Array, "4 3 3"], forces_base: Float[Array, "4 3"]) -> Float[Array, "12"]:
    """The torques -J' f of standing legs under forces of the ground f [N]. In [Nm]."""
    return -jnp.einsum("lij,li->lj", jacobian, forces_base).reshape(-1)


def swing_joint_target(
    robot: RobotModel, robot_state: RobotState, R_world_base: jax.Array, jacobian: jax.Array, swing: SwingTarget
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Joint positions, velocities and accelerations that follow the feet's paths, shape (12,) each.

    In [rad], [rad/s], [rad/s^2]; the acceleration leaves out what the turning of leg and trunk adds.
    """
    position, velocity, acceleration = swing_path(
        swing.lift_off_world, swing.foothold_world, swing.step_height, swing.progress, swing.duration
    )
    position = position.at[:, 2].add(-swing.depth)
    velocity = velocity.at[:, 2].add(-swing.descent)
    acceleration = acceleration.at[:, 2].add(-swing.fall)
    foot_base = (position - robot_state.base_pos) @ R_world_base
    relative = (velocity - robot_state.base_lin_vel_world) @ R_world_base
    relative -= jnp.cross(robot_state.base_ang_vel_base, foot_base)
    joint_pos = leg_inverse_kinematics(robot, foot_base)
    wanted = jnp.stack([relative, acceleration @ R_world_base], -1)  # (4, 3, 2)
    joint_vel, joint_acc = jnp.moveaxis(joint_motion(jacobian, wanted), -1, 0)
    return joint_pos, joint_vel.reshape(-1), joint_acc.reshape(-1)


def joint_motion(jacobian: Float[Array, "4 3 3"], foot_motion: Float[Array, "4 3 k"]) -> Float[Array, "4 3 k"]:
    """Joint velocities of feet's. By damped least squares: near a stretched leg the plain inverse is unbounded."""
    gram = jnp.einsum("lij,lkj->lik", jacobian, jacobian) + JACOBIAN_DAMPING**2 * jnp.eye(3)
    return jnp.einsum("lji,ljm,lmk->lik", jacobian, inverse_3x3(gram, jnp), foot_motion)


def stance_joint_velocity(
    robot: RobotModel,
    robot_state: RobotState,
    R_world_base: Float[Array, "3 3"],
    jacobian: Float[Array, "4 3 3"],
    velocity: Float[Array, "4"],
) -> Float[Array, "12"]:
    """Joint velocities of standing legs under a trunk that moves with a velocity [m/s, rad/s]. In [rad/s]."""
    feet = leg_forward_kinematics(robot, robot_state.joint_pos)
    relative = -(velocity[:3] @ R_world_base + jnp.cross(velocity[3] * R_world_base[2], feet))
    return joint_motion(jacobian, relative[..., None]).reshape(-1)


def leg_inertia(robot: RobotModel, joint_pos: Float[np.ndarray, "12"]) -> Float[np.ndarray, "4 3 3"]:
    """Joint-space inertia of each leg with the trunk held, the motors' included [kg m^2]."""
    masses, coms, inertias = (np.asarray(a) for a in (robot.link_masses, robot.link_coms, robot.link_inertias))

    def motion(q: jax.Array) -> tuple[jax.Array, jax.Array]:
        poses = link_poses(robot, q)
        return poses.pos + jnp.einsum("bij,bj->bi", poses.rotation, coms), poses.rotation

    rotation = np.asarray(motion(jnp.asarray(joint_pos))[1])
    rates = jax.jacfwd(motion)(jnp.asarray(joint_pos))
    slide, turn = (np.asarray(rate) for rate in rates)  # (13, 3, 12), (13, 3, 3, 12)
    spin = np.einsum("bijk,blj->bilk", turn, rotation)  # the skew matrix of each link's angular velocity
    spin = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], 1)  # (13, 3, 12)
    turned = rotation @ inertias @ np.swapaxes(rotation, 1, 2)
    whole = np.einsum("b,bij,bik->jk", masses, slide, slide) + np.einsum("bij,bik,bkl->jl", spin, turned, spin)
    whole += np.diag(robot.joint_armature)
    return np.stack([whole[3 * leg : 3 * leg + 3, 3 * leg : 3 * leg + 3] for leg in range(4)])


def limit_guard(
    robot: RobotModel, joint_pos: Float[Array, "12"], joint_vel: Float[Array, "12"], stiffness: float
) -> Float[Array, "12"]:
    """Torques that stop joints before their limits: a spring on where they will be shortly [Nm].

    A leg that swings forward fast folds its knee by inertia, further than its path asks.
    """
    soon = joint_pos + GUARD_TIME * joint_vel
    below = jnp.maximum(robot.joint_lower + GUARD_MARGIN - soon, 0.0)
    above = jnp.maximum(soon - robot.joint_upper + GUARD_MARGIN, 0.0)
    return GUARD_STIFFNESS * stiffness * (below - above)


def whole_body_torque(
    robot: RobotModel,
    settings: ControlSettings,
    inertia: Float[AnyArray, "4 3 3"],
    robot_state: RobotState,
    R_world_base: Float[Array, "3 3"],
    standing: Bool[Array, "4"],
    forces_world: Float[Array, "4 3"],
    trunk_velocity: Float[Array, "4"],
    swing: SwingTarget,
) -> Float[Array, "12"]:
    """Torques that the planned forces and paths ask of the joints, limits aside [Nm].

    Args:
        robot, settings, robot_state: of one robot.
        inertia: from `leg_inertia`, fed forward to the legs in the air [kg m^2].
        R_world_base: measured.
        standing: which feet stand.
        forces_world: planned forces of the ground on the feet [N].
        trunk_velocity: planned, of x, y, z and yaw in the world [m/s, rad/s].
        swing: the paths of the feet in the air.
    """
    jacobian = leg_jacobian(robot, robot_state.joint_pos)  # (4, 3, 3) base frame
    stance = stance_torque(jacobian, forces_world @ R_world_base)
    target_pos, target_vel, target_acc = swing_joint_target(robot, robot_state, R_world_base, jacobian, swing)
    pd = settings.swing_stiffness * (target_pos - robot_state.joint_pos)
    pd += settings.swing_damping * (target_vel - robot_state.joint_vel)
    pd += jnp.einsum("lij,lj->li", inertia, target_acc.reshape(4, 3)).reshape(-1)
    pd += limit_guard(robot, robot_state.joint_pos, robot_state.joint_vel, settings.swing_stiffness)
    stands = jnp.repeat(standing, 3)
    planned = stance_joint_velocity(robot, robot_state, R_world_base, jacobian, trunk_velocity)
    torque = jnp.where(stands, stance, pd) + gravity_torque(robot, robot_state.joint_pos, R_world_base)
    return torque + passive_torque(robot, jnp.where(stands, planned, robot_state.joint_vel))
