"""Convex model predictive control: the quadratic program, apart from its solution.

    minimise   sum_k |xi_{k+1} - xi_ref|_Q^2 + |xi'_{k+1} - xi'_ref|_P^2 + w |f_k|^2

(Di Carlo et al. 2018, equation 18) over the foot forces of N nodes, with the dynamics of `centroidal` substituted
(condensing): xi = free + G y, y_k = B_k f_k. What multiplies y is, axis by axis,

    H = G_p' Q G_p + G_v' P G_v,    h = G_p' Q (free_p - ref) + G_v' P (free_v - ref')
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.control.centroidal import AXES, BodyState, double_integrator_response, force_map, free_response
from agile_jax.control.cone_qp import Qp
from agile_jax.control.settings import MpcSettings


class MpcConstants(NamedTuple):
    """What depends on settings only. N nodes; axes roll, pitch, yaw, x, y, z."""

    hessian_inverse: jax.Array  # (6N, 6N)
    position_gain: jax.Array  # (6, N, N) G_p' Q
    velocity_gain: jax.Array  # (6, N, N) G_v' P


def mpc_constants(settings: MpcSettings) -> MpcConstants:
    """Invert the Hessian once, in float64."""
    nodes = settings.horizon
    response = double_integrator_response(nodes, settings.mpc_dt)
    position_weight = np.array(settings.weight_orientation + settings.weight_position)
    velocity_weight = np.array(settings.weight_angular_velocity + settings.weight_velocity)
    position_gain = position_weight[:, None, None] * response.position.T
    velocity_gain = velocity_weight[:, None, None] * response.velocity.T
    hessian = position_gain @ response.position + velocity_gain @ response.velocity  # (6, N, N)
    inverse = np.zeros((nodes, AXES, nodes, AXES))
    for axis in range(AXES):
        inverse[:, axis, :, axis] = np.linalg.inv(hessian[axis])
    return MpcConstants(
        jnp.asarray(inverse.reshape(AXES * nodes, AXES * nodes), jnp.float32),
        jnp.asarray(position_gain, jnp.float32),
        jnp.asarray(velocity_gain, jnp.float32),
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
    """
    free = free_response(body, settings.horizon, settings.mpc_dt)
    linear = jnp.einsum("akj,ja->ka", constants.position_gain, free.position - reference.position)
    linear += jnp.einsum("akj,ja->ka", constants.velocity_gain, free.velocity - reference.velocity)
    return Qp(
        hessian_inverse=constants.hessian_inverse,
        linear=linear,
        force_map=force_map(mass, inertia, levers),
        contact=contact,
        friction=jnp.float32(settings.friction),
        force_max=jnp.float32(settings.force_max),
        force_weight=jnp.float32(settings.weight_force),
    )
