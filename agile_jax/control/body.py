"""The robot as one rigid body, measured, and its reference, both in the yaw frame of `centroidal`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.control.mpc.centroidal import BodyState
from agile_jax.geometry import quaternion_to_matrix, quaternion_to_rpy, rotation_2d, wrap_angle
from agile_jax.robot import RobotModel, RobotState, composite_inertia


class Reference(NamedTuple):
    """What the trunk should do. Poses are [x, y, z, yaw] in the world [m, rad]; N nodes of the MPC."""

    pose: Float[Array, "4"]  # now
    velocity: Float[Array, "4"]  # now [m/s, rad/s]
    poses: Float[Array, "N 4"]  # at the ends of the MPC's steps
    velocities: Float[Array, "N 4"]


class Body(NamedTuple):
    """The measured state of the robot as one rigid body."""

    R_world_base: Float[Array, "3 3"]
    R_world_yaw: Float[Array, "3 3"]
    rpy: Float[Array, "3"]  # [rad]
    com_world: Float[Array, "3"]  # [m]
    com_velocity_world: Float[Array, "3"]  # [m/s]
    mass: Float[Array, ""]  # [kg]
    inertia_base: Float[Array, "3 3"]  # about the centre of mass [kg m^2]
    com_base: Float[Array, "3"]  # [m]


def measure(robot: RobotModel, state: RobotState) -> Body:
    """Composite mass properties at the current posture, and the motion of the centre of mass."""
    R_world_base = quaternion_to_matrix(state.base_quat, jnp)
    rpy = quaternion_to_rpy(state.base_quat, jnp)

    def center(joint_pos: jax.Array) -> jax.Array:
        return composite_inertia(robot, joint_pos)[1]

    mass, com_base, inertia = composite_inertia(robot, state.joint_pos)
    _, com_rate = jax.jvp(center, (state.joint_pos,), (state.joint_vel,))
    velocity = state.base_lin_vel_world + R_world_base @ (jnp.cross(state.base_ang_vel_base, com_base) + com_rate)
    return Body(
        R_world_base,
        rotation_z(rpy[2]),
        rpy,
        state.base_pos + R_world_base @ com_base,
        velocity,
        mass,
        inertia,
        com_base,
    )


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
