"""Convex model predictive control: the quadratic program, apart from its solution.

    minimise   sum_k |xi_{k+1} - xi_ref|_Q^2 + |xi'_{k+1} - xi'_ref|_P^2 + w |f_k|^2

(Di Carlo et al. 2018, equation 18) over the foot forces of N nodes, with the dynamics of `centroidal` substituted
(condensing): xi = free + G y, y_k = B_k f_k. What multiplies y is, axis by axis,

    H = G_p' Q G_p + G_v' P G_v,    h = G_p' Q (free_p - ref) + G_v' P (free_v - ref')

Hard constraints, for every foot that stands in step k (the others have f = 0):

- the friction cone |f_xy| <= mu f_z, and 0 <= f_z <= f_max (equations 22 and 23 there, which take the pyramid inside
  the cone). mu is `MpcSettings.friction`, the field `friction` of `Qp`; `solver/projection.py` projects forces onto the
  cone, or the pyramid, in every iteration of the solver; nothing else imposes it.
- the torques and positions of the joints (`leg_limits.py`).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.control.body import Body, Reference, body_in_yaw_frame, inertia_in_yaw_frame, reference_in_yaw_frame
from agile_jax.control.mpc.centroidal import AXES, BodyState, double_integrator_response, force_map, free_response
from agile_jax.control.mpc.leg_limits import JointRows, TorqueRows, joint_rows, nominal_motion, torque_rows
from agile_jax.control.settings import MpcSettings
from agile_jax.robot import RobotModel, RobotState


class MpcConstants(NamedTuple):
    """What depends on settings only. N nodes; axes roll, pitch, yaw, x, y, z; wrenches ordered by node, then axis."""

    hessian: Float[Array, "W W"]  # H, W = 6N
    hessian_inverse: Float[Array, "W W"]  # its inverse, made in float64
    response: Float[Array, "N N"]  # G_p: accelerations of an axis to its positions after each step [s^2]
    position_gain: Float[Array, "6 N N"]  # G_p' Q
    velocity_gain: Float[Array, "6 N N"]  # G_v' P


class Qp(NamedTuple):
    """One problem. N nodes, 4 feet; forces in [N], accelerations in [m/s^2], [rad/s^2], positions in [m], [rad].

    minimise    1/2 y' H y + h' y + w/2 |f|^2,    y_k = B_k f_k,    with H of the `MpcConstants`
    """

    linear: Float[Array, "N 6"]  # h
    force_map: Float[Array, "N 6 12"]  # B_k
    contact: Float[Array, "N 4"]  # 1 where the foot stands, else 0
    friction: Float[Array, ""]  # mu
    force_max: Float[Array, ""]  # [N]
    force_weight: Float[Array, ""]  # w
    torque: TorqueRows  # lower <= map f <= upper for each standing foot
    joint: JointRows  # lower <= map_k (G_p y)_k <= upper: free fall is subtracted from the bounds


def mpc_constants(settings: MpcSettings) -> MpcConstants:
    """Invert the Hessian once, in float64."""
    nodes = settings.horizon
    response = double_integrator_response(nodes, settings.mpc_dt)
    position_weight = np.array(settings.weight_orientation + settings.weight_position)
    velocity_weight = np.array(settings.weight_angular_velocity + settings.weight_velocity)
    position_gain = position_weight[:, None, None] * response.position.T
    velocity_gain = velocity_weight[:, None, None] * response.velocity.T
    hessian = position_gain @ response.position + velocity_gain @ response.velocity  # (6, N, N)
    whole, inverse = np.zeros((2, nodes, AXES, nodes, AXES))
    for axis in range(AXES):
        whole[:, axis, :, axis] = hessian[axis]
        inverse[:, axis, :, axis] = np.linalg.inv(hessian[axis])
    return MpcConstants(
        *(
            jnp.asarray(array, jnp.float32)
            for array in (
                whole.reshape(AXES * nodes, AXES * nodes),
                inverse.reshape(AXES * nodes, AXES * nodes),
                response.position,
                position_gain,
                velocity_gain,
            )
        )
    )


def build_qp(
    constants: MpcConstants,
    settings: MpcSettings,
    body: BodyState,
    reference: BodyState,
    mass: jax.Array,
    inertia: jax.Array,
    levers: jax.Array,
    contact: jax.Array,
    torque: TorqueRows,
    joint: JointRows,
) -> Qp:
    """The quadratic program at one state.

    Args:
        constants, settings: of the controller.
        body: current state in the yaw frame.
        reference: at the ends of the N steps, shape (N, 6) each.
        mass: () [kg].
        inertia: (3, 3) about the centre of mass in the yaw frame [kg m^2].
        levers: (N, 4, 3) feet relative to the centre of mass in the yaw frame [m].
        contact: (N, 4) 1 for a standing foot.
        torque: limits on the forces.
        joint: limits on the states after each step.
    """
    free = free_response(body, settings.horizon, settings.mpc_dt)
    linear = jnp.einsum("akj,ja->ka", constants.position_gain, free.position - reference.position)
    linear += jnp.einsum("akj,ja->ka", constants.velocity_gain, free.velocity - reference.velocity)
    falling = jnp.einsum("kij,kj->ki", joint.map, free.position)
    return Qp(
        linear=linear,
        force_map=force_map(mass, inertia, levers),
        contact=contact,
        friction=jnp.float32(settings.friction),
        force_max=jnp.float32(settings.force_max),
        force_weight=jnp.float32(settings.weight_force),
        torque=torque,
        joint=JointRows(joint.map, joint.lower - falling, joint.upper - falling),
    )


def robot_qp(
    constants: MpcConstants,
    settings: MpcSettings,
    robot: RobotModel,
    robot_state: RobotState,
    body: Body,
    reference: Reference,
    integral: jax.Array,
    support: jax.Array,
    contact: jax.Array,
) -> Qp:
    """The quadratic program of a robot.

    Args:
        constants, settings, robot: of the controller.
        robot_state, body: measured.
        reference: of the trunk.
        integral: (3,) correction of height [m], roll and pitch [rad].
        support: (N, 4, 3) where each foot stands during each step, or stood, or will, in the world [m].
        contact: (N, 4) 1 for a foot that stands during the step.
    """
    moved = jnp.concatenate([jnp.zeros((1, 4)), reference.poses - reference.pose])
    begin = nominal_motion(robot, body, moved[:-1], support)
    end = nominal_motion(robot, body, moved[1:], support)
    return build_qp(
        constants,
        settings,
        body_in_yaw_frame(robot_state, body),
        reference_in_yaw_frame(reference, body, integral),
        body.mass,
        inertia_in_yaw_frame(body),
        begin.levers,
        contact,
        torque_rows(robot, robot_state, body, reference, begin),
        joint_rows(robot, end, contact, settings.joint_margin),
    )
