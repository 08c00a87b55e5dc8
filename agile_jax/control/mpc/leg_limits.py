"""Limits of the joints as linear constraints of the MPC: torques on the forces, positions on the predicted states.

Everything is linearised about the nominal motion: the measured pose, carried along the reference (the same motion
that the lever arms of `mpc` belong to). At its node k the trunk has the rotation R_k and the centre of mass c_k, and a
foot that stands at p has the place r = R_k' (p - c_k) + com_base in the base, from which inverse kinematics gives the
leg's posture q_k with the Jacobian J_k. With d = p - c_k:

Torque (Di Carlo et al. 2018, equation 5, statics of a light leg): tau = tau_ff - J_k' R_k' f, so |tau| <= tau_max is

    tau_ff - tau_max <= J_k' R_k' f <= tau_ff + tau_max.

tau_ff holds the legs' weight and overcomes the joints' damping at the speed of the nominal motion. Where tau_ff alone
exceeds the limit no force may add to it: the bounds are widened just to contain f = 0, so a solution always exists.

Position: the foot is fixed, so when the trunk turns by dphi and moves by dc from its nominal pose, r moves by
R_k' (d x dphi - dc), and

    q = q_k + J_k^-1 (r - FK(q_k)) + C_k [dphi, dc],    C_k = J_k^-1 R_k' [ [d]x  -1 ],

must stay within [q_min, q_max]. It is linear in the predicted positions of the body alone, not in its velocities. The
rows are those of every foot that stands during a step, on the state at the step's end: the state before the first step
is given, and over one step of 30 ms a joint that obeys its limits at both ends cannot pass them by more than
a dt^2 / 8, a milliradian at 10 rad/s^2. Legs in the air have no rows: their paths come from inverse kinematics, which
keeps the limits. (r - FK(q_k) is zero unless the nominal posture is out of reach or beyond a limit.)
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.control.body import Body, Reference, rotation_z
from agile_jax.control.joint_model import passive_torque
from agile_jax.control.mpc.centroidal import AXES, cross_matrix
from agile_jax.control.torques import gravity_torque
from agile_jax.geometry import inverse_3x3
from agile_jax.robot import RobotModel, RobotState, leg_forward_kinematics, leg_inverse_kinematics, leg_jacobian

DAMPING = 2e-3  # of the inverse Jacobian near a stretched leg [m/rad]


class TorqueRows(NamedTuple):
    """lower <= map @ f <= upper for each node and foot. N nodes."""

    map: Float[Array, "N 4 3 3"]  # on forces in the yaw frame [m]
    lower: Float[Array, "N 4 3"]  # [Nm], never above 0
    upper: Float[Array, "N 4 3"]  # [Nm], never below 0


class JointRows(NamedTuple):
    """lower <= map @ xi_k <= upper for the states after each step; infinite bounds where a foot is in the air."""

    map: Float[Array, "N 12 6"]  # on positions of the body
    lower: Float[Array, "N 12"]  # [rad]
    upper: Float[Array, "N 12"]  # [rad]


class Nominal(NamedTuple):
    """The nominal motion at N moments."""

    R_base_yaw: Float[Array, "N 3 3"]
    position: Float[Array, "N 6"]  # xi of `centroidal`
    levers: Float[Array, "N 4 3"]  # feet relative to the centre of mass in the yaw frame [m]
    joint_pos: Float[Array, "N 12"]  # with the feet on their places, to first order beyond limits and reach [rad]
    jacobian: Float[Array, "N 4 3 3"]  # [m/rad]
    jacobian_inverse: Float[Array, "N 4 3 3"]  # [rad/m]


def nominal_motion(robot: RobotModel, body: Body, moved: jax.Array, support: jax.Array) -> Nominal:
    """The measured pose carried along the reference.

    Args:
        robot: constants.
        body: measured.
        moved: (N, 4) how far the reference has gone from where it is now [m, rad].
        support: (N, 4, 3) where each foot stands in the world [m].
    """
    R_world_base = rotation_z(moved[:, 3]) @ body.R_world_base
    levers_world = support - (body.com_world + moved[:, :3])[:, None]  # (N, 4, 3)
    foot_base = jnp.einsum("kij,kli->klj", R_world_base, levers_world) + body.com_base
    joint_pos = jax.vmap(leg_inverse_kinematics, (None, 0))(robot, foot_base)
    jacobian = jax.vmap(leg_jacobian, (None, 0))(robot, joint_pos)
    inverse = damped_inverse(jacobian)
    missed = foot_base - jax.vmap(leg_forward_kinematics, (None, 0))(robot, joint_pos)
    tilt = jnp.broadcast_to(body.rpy[:2], (len(moved), 2))
    height = body.com_world[2] + moved[:, 2]
    position = jnp.concatenate([tilt, moved[:, 3:], moved[:, :2] @ body.R_world_yaw[:2, :2], height[:, None]], -1)
    return Nominal(
        jnp.swapaxes(R_world_base, -1, -2) @ body.R_world_yaw,
        position,
        levers_world @ body.R_world_yaw,
        joint_pos + jnp.einsum("klij,klj->kli", inverse, missed).reshape(-1, 12),
        jacobian,
        inverse,
    )


def damped_inverse(jacobian: jax.Array) -> jax.Array:
    """(J'J + e^2)^-1 J', bounded near a stretched leg. Shape (..., 3, 3)."""
    transposed = jnp.swapaxes(jacobian, -1, -2)
    gram = transposed @ jacobian + DAMPING**2 * jnp.eye(3)
    return inverse_3x3(gram, jnp) @ transposed


def torque_rows(
    robot: RobotModel, robot_state: RobotState, body: Body, reference: Reference, begin: Nominal
) -> TorqueRows:
    """Torque limits of the feet at the beginnings of the N steps.

    Args:
        robot: constants.
        robot_state, body: measured.
        reference: of the trunk.
        begin: nominal motion at the beginnings of the steps.
    """
    matrix = jnp.einsum("klij,kim->kljm", begin.jacobian, begin.R_base_yaw)
    feed_forward = gravity_torque(robot, robot_state.joint_pos, body.R_world_base)
    velocity = nominal_joint_velocity(body, reference, begin)
    feed_forward += jax.vmap(passive_torque, (None, 0))(robot, velocity)
    lower = jnp.minimum(feed_forward - robot.torque_limit, 0.0)
    upper = jnp.maximum(feed_forward + robot.torque_limit, 0.0)
    return TorqueRows(matrix, lower.reshape(matrix.shape[:-1]), upper.reshape(matrix.shape[:-1]))


def nominal_joint_velocity(body: Body, reference: Reference, begin: Nominal) -> jax.Array:
    """Joint velocities of standing feet under the reference, at the beginnings of the N steps.

    Returns:
        Shape (N, 12) [rad/s].
    """
    velocities = jnp.concatenate([reference.velocity[None], reference.velocities[:-1]])
    levers = begin.levers
    turning = velocities[:, 3, None, None] * jnp.stack([-levers[..., 1], levers[..., 0], 0 * levers[..., 0]], -1)
    foot = -((velocities[:, :3] @ body.R_world_yaw)[:, None] + turning)  # (N, 4, 3) seen from the trunk, yaw frame
    return jnp.einsum("klij,kjm,klm->kli", begin.jacobian_inverse, begin.R_base_yaw, foot).reshape(-1, 12)


def joint_rows(robot: RobotModel, end: Nominal, contact: jax.Array, margin: float) -> JointRows:
    """Position limits of the standing legs at the ends of the N steps.

    Args:
        robot: constants.
        end: nominal motion at the ends of the steps.
        contact: (N, 4) 1 for a foot that stands during the step.
        margin: kept from the limits [rad].
    """
    nodes = len(contact)
    motion = jnp.concatenate([cross_matrix(end.levers), jnp.broadcast_to(-jnp.eye(3), (nodes, 4, 3, 3))], -1)
    matrix = jnp.einsum("klij,kjm,klmn->klin", end.jacobian_inverse, end.R_base_yaw, motion).reshape(nodes, 12, AXES)
    stands = jnp.repeat(contact > 0, 3, -1)
    offset = end.joint_pos - jnp.einsum("kij,kj->ki", matrix, end.position)
    lower = jnp.where(stands, robot.joint_lower + margin - offset, -jnp.inf)
    upper = jnp.where(stands, robot.joint_upper - margin - offset, jnp.inf)
    return JointRows(matrix * stands[..., None], lower, upper)
