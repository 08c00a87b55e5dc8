"""Single-rigid-body dynamics of a legged robot in wrench space (Di Carlo et al. 2018, equations 5 to 17).

Everything is expressed in the yaw frame: z up, x along the trunk's heading at the moment of planning. With small roll
and pitch, the body coordinates xi = [roll, pitch, yaw, x, y, z] (centre of mass) obey

    xi'' = y + g,    y = B f,    B = [ I^-1 [r_1]x ... I^-1 [r_4]x ;  1/m ... 1/m ],    g = [0 0 0 0 0 -9.81]

that is, six identical double integrators driven by the accelerations y. Held constant over a step, y gives exactly
xi+ = xi + dt xi' + dt^2/2 (y + g), xi'+ = xi' + dt (y + g).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.robot import GRAVITY

AXES = 6


class BodyState(NamedTuple):
    """State of the single rigid body in the yaw frame."""

    position: Float[Array, "6"]  # xi: roll, pitch, yaw [rad], centre of mass x, y, z [m]
    velocity: Float[Array, "6"]  # xi'


class Response(NamedTuple):
    """Linear maps from the accelerations (N,) of one axis to its states after each step (N,)."""

    position: Float[np.ndarray, "N N"]  # lower triangular [s^2]
    velocity: Float[np.ndarray, "N N"]  # [s]


def double_integrator_response(nodes: int, dt: float) -> Response:
    """Exact response of a double integrator to piecewise-constant acceleration, in float64."""
    steps = np.arange(nodes)
    age = steps[:, None] - steps[None, :]
    causal = age >= 0
    return Response(np.where(causal, dt**2 * (age + 0.5), 0.0), np.where(causal, dt, 0.0))


def free_response(body: BodyState, nodes: int, dt: float) -> BodyState:
    """States after 1..N steps of free fall, shape (N, 6) each."""
    elapsed = (dt * jnp.arange(1, nodes + 1))[:, None]
    gravity = jnp.zeros(AXES).at[5].set(-GRAVITY)
    velocity = body.velocity + elapsed * gravity
    return BodyState(body.position + elapsed * body.velocity + elapsed**2 / 2 * gravity, velocity)


def cross_matrix(vector: jax.Array) -> jax.Array:
    """[v]x with [v]x u = v x u. Shape (..., 3) to (..., 3, 3)."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = jnp.zeros_like(x)
    return jnp.stack(
        [jnp.stack([zero, -z, y], -1), jnp.stack([z, zero, -x], -1), jnp.stack([-y, x, zero], -1)],
        -2,
    )


def force_map(mass: jax.Array, inertia: jax.Array, levers: jax.Array) -> jax.Array:
    """B: accelerations of the body per foot force.

    Args:
        mass: () [kg].
        inertia: (3, 3) about the centre of mass in the yaw frame [kg m^2].
        levers: (..., 4, 3) feet relative to the centre of mass in the yaw frame [m].

    Returns:
        (..., 6, 12), columns ordered foot by foot [1/kg], [1/(kg m)].
    """
    angular = jnp.einsum("ij,...ljk->...ilk", jnp.linalg.inv(inertia), cross_matrix(levers))  # (..., 3, 4, 3)
    linear = jnp.broadcast_to((jnp.eye(3) / mass)[:, None, :], angular.shape)
    return jnp.concatenate([angular, linear], -3).reshape(*levers.shape[:-2], AXES, 12)
