"""The robot as one rigid body, measured, and its reference, both in the yaw frame of `centroidal`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.control.mpc.centroidal import BodyState
from agile_jax.control.torques import joint_motion
from agile_jax.geometry import quaternion_to_matrix, quaternion_to_rpy, rotation_2d, wrap_angle
from agile_jax.robot import (
    RobotModel,
    RobotState,
    composite_inertia,
    leg_forward_kinematics,
    leg_jacobian,
    link_poses,
)


class Reference(NamedTuple):
    """What the trunk should do. Poses are [x, y, z, yaw] in the world [m, rad]; N nodes of the MPC."""

    pose: Float[Array, "4"]  # now
    velocity: Float[Array, "4"]  # now [m/s, rad/s]
    poses: Float[Array, "N 4"]  # at the ends of the MPC's steps
    velocities: Float[Array, "N 4"]


def slowed(reference: Reference, top: Float[Array, ""]) -> Reference:
    """The same way at no more than a top speed in the plane [m/s]."""
    fastest = jnp.sqrt(jnp.sum(reference.velocities[:, :2] ** 2, -1)).max()
    share = jnp.minimum(1.0, top / jnp.maximum(fastest, 1e-6))
    return Reference(
        reference.pose,
        share * reference.velocity,
        reference.pose + share * (reference.poses - reference.pose),
        share * reference.velocities,
    )


class Body(NamedTuple):
    """The measured state of the robot as one rigid body."""

    R_world_base: Float[Array, "3 3"]
    R_world_yaw: Float[Array, "3 3"]
    rpy: Float[Array, "3"]  # [rad]
    com_world: Float[Array, "3"]  # [m]
    com_velocity_world: Float[Array, "3"]  # [m/s]
    mass: Float[Array, ""]  # [kg]
    inertia_base: Float[Array, "3 3"]  # of turning over the feet, about the centre of mass [kg m^2]
    com_base: Float[Array, "3"]  # [m]


def measure(robot: RobotModel, state: RobotState) -> Body:
    """Composite mass properties at the current posture, and the motion of the centre of mass."""
    R_world_base = quaternion_to_matrix(state.base_quat, jnp)
    rpy = quaternion_to_rpy(state.base_quat, jnp)

    def center(joint_pos: jax.Array) -> jax.Array:
        return composite_inertia(robot, joint_pos)[1]

    mass, com_base, _ = composite_inertia(robot, state.joint_pos)
    _, com_rate = jax.jvp(center, (state.joint_pos,), (state.joint_vel,))
    velocity = state.base_lin_vel_world + R_world_base @ (jnp.cross(state.base_ang_vel_base, com_base) + com_rate)
    return Body(
        R_world_base,
        rotation_z(rpy[2]),
        rpy,
        state.base_pos + R_world_base @ com_base,
        velocity,
        mass,
        turning_inertia(robot, state.joint_pos, com_base),
        com_base,
    )


def turning_inertia(robot: RobotModel, joint_pos: Float[Array, "12"], center: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """What the feet's moments turn: the inertia about `center` with the feet held where they are [kg m^2].

    The joints give way when the trunk turns over its feet, J q' = -w x r, so the legs do not turn with it, but the
    rotors do, q' times: kinetic energy is w' I w / 2. It is what a moment of the feet's forces f accelerates, since the
    joints get -J' f. The inertia of the posture as one rigid body is up to five times as large for rolling, and a loop
    of 50 Hz that believes it is unstable where no rotor makes up for the difference.

    Args:
        robot: constants.
        joint_pos: [rad].
        center: in the base frame [m].
    """
    axes = jnp.eye(3)
    feet = leg_forward_kinematics(robot, joint_pos) - center
    rates = joint_motion(leg_jacobian(robot, joint_pos), -jnp.swapaxes(jnp.cross(axes[:, None], feet), 0, 1).mT)
    rates = rates.reshape(-1, 3).T  # of the joints, for a turn about each axis (3, 12)

    def place(q: jax.Array) -> tuple[jax.Array, jax.Array]:
        poses = link_poses(robot, q)
        return poses.pos + jnp.einsum("bij,bj->bi", poses.rotation, robot.link_coms), poses.rotation

    def motion(axis: jax.Array, rate: jax.Array) -> tuple[jax.Array, jax.Array]:
        (com, rotation), (slide, turn) = jax.jvp(place, (joint_pos,), (rate,))
        own = jnp.einsum("bji,bjk->bik", rotation, turn)  # the skew matrix of the turning, in the link's axes
        spin = jnp.stack([own[:, 2, 1], own[:, 0, 2], own[:, 1, 0]], -1) + axis @ rotation
        return jnp.cross(axis, com - center) + slide, spin

    linear, angular = jax.vmap(motion)(axes, rates)
    whole = jnp.einsum("b,ibk,jbk->ij", robot.link_masses, linear, linear)
    whole += jnp.einsum("ibk,bkl,jbl->ij", angular, robot.link_inertias, angular)
    return whole + (rates * robot.joint_armature) @ rates.T


def body_in_yaw_frame(robot_state: RobotState, body: Body) -> BodyState:
    """The current state with the origin at the centre of mass's ground point and x along the heading."""
    position = jnp.concatenate([body.rpy[:2], jnp.zeros(3), body.com_world[2:]])
    angular = body.R_world_base @ robot_state.base_ang_vel_base
    return BodyState(
        position, jnp.concatenate([angular @ body.R_world_yaw, body.com_velocity_world @ body.R_world_yaw])
    )


def reference_in_yaw_frame(reference: Reference, body: Body, integral: jax.Array) -> BodyState:
    """The reference of the centre of mass at the nodes, shape (N, 6) each.

    Args:
        reference: of the trunk.
        body: measured.
        integral: (3,) what is added to height [m], roll and pitch [rad].
    """
    nodes = len(reference.poses)
    yaws = wrap_angle(reference.poses[:, 3] - body.rpy[2], jnp)
    # The trunk's reference, shifted to the centre of mass with the trunk level at the reference's yaw.
    offset = jnp.einsum("nij,j->ni", rotation_2d(reference.poses[:, 3], jnp), body.com_base[:2])
    R_yaw = body.R_world_yaw[:2, :2]
    planar = (reference.poses[:, :2] + offset - body.com_world[:2]) @ R_yaw
    height = reference.poses[:, 2] + body.com_base[2] + integral[0]
    tilt = jnp.broadcast_to(integral[1:], (nodes, 2))
    position = jnp.concatenate([tilt, yaws[:, None], planar, height[:, None]], -1)
    velocities = reference.velocities
    velocity = jnp.concatenate(
        [jnp.zeros((nodes, 2)), velocities[:, 3:], velocities[:, :2] @ R_yaw, velocities[:, 2:3]], -1
    )
    return BodyState(position, velocity)


def inertia_in_yaw_frame(body: Body) -> jax.Array:
    """Inertia about the centre of mass, turned by roll and pitch only. Shape (3, 3) [kg m^2]."""
    R = body.R_world_yaw.T @ body.R_world_base
    return R @ body.inertia_base @ R.T


def rotation_z(yaw: jax.Array) -> jax.Array:
    """Rotation about z by yaw [rad]. Shape (...) to (..., 3, 3)."""
    planar = rotation_2d(yaw, jnp)
    matrix = jnp.zeros((*yaw.shape, 3, 3)).at[..., :2, :2].set(planar)
    return matrix.at[..., 2, 2].set(1.0)
