"""The quadratic program of the MPC in units in which float32 suffices: forces of 30 N, torques of 30 N x 0.2 m."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control.leg_limits import JointRows, TorqueRows
from agile_jax.control.mpc import Qp

FORCE_UNIT = 30.0  # [N], about a quarter of the robot's weight
LEVER_UNIT = 0.2  # [m], about a joint's lever arm: a row of torque has about the length of a row of force

Projection = Callable[[jax.Array], jax.Array]  # of forces (N, 4, 3) onto those that their feet can have


class ScaledQp(NamedTuple):
    """minimise 1/2 y' H y + h' y + w/2 |g|^2 over g = f / FORCE_UNIT, y_k = B_k g_k; fields as in `Qp`."""

    hessian: jax.Array  # (6, N, N)
    hessian_inverse: jax.Array  # (6N, 6N)
    response: jax.Array  # (N, N)
    linear: jax.Array  # (N, 6)
    force_map: jax.Array  # (N, 6, 12) zero for a foot in the air
    contact: jax.Array  # (N, 4)
    friction: jax.Array  # ()
    force_max: jax.Array  # ()
    force_weight: jax.Array  # ()
    torque: TorqueRows
    joint: JointRows

    def wrench(self, forces: jax.Array) -> jax.Array:
        """Y of the forces (N, 4, 3). Shape (N, 6)."""
        return jnp.einsum("kai,ki->ka", self.force_map, forces.reshape(-1, 12))

    def wrench_transposed(self, multiplier: jax.Array) -> jax.Array:
        """B' times (N, 6). Shape (N, 4, 3)."""
        return jnp.einsum("kai,ka->ki", self.force_map, multiplier).reshape(-1, 4, 3)

    def torques(self, forces: jax.Array) -> jax.Array:
        """What the rows of torque limit. Shape (N, 4, 3)."""
        return jnp.einsum("klij,klj->kli", self.torque.map, forces)

    def joints(self, wrench: jax.Array) -> jax.Array:
        """What the rows of the joints' positions limit. Shape (N, 12)."""
        return jnp.einsum("kia,ka->ki", self.joint.map, self.response @ wrench)

    def joints_transposed(self, rows: jax.Array) -> jax.Array:
        """The transpose of `joints`. Shape (N, 12) to (N, 6)."""
        return self.response.T @ jnp.einsum("kia,ki->ka", self.joint.map, rows)

    def gradient(self, wrench: jax.Array) -> jax.Array:
        """H y + h. Shape (N, 6)."""
        return jnp.einsum("aij,ja->ia", self.hessian, wrench) + self.linear


def scale(qp: Qp) -> ScaledQp:
    """Change the units, and take the forces of feet in the air out of the dynamics."""
    stands = jnp.repeat(qp.contact, 3, -1)[:, None]
    torque = qp.torque
    unit = FORCE_UNIT * LEVER_UNIT
    return ScaledQp(
        qp.hessian,
        qp.hessian_inverse,
        qp.response,
        qp.linear,
        qp.force_map * FORCE_UNIT * stands,
        qp.contact,
        qp.friction,
        qp.force_max / FORCE_UNIT,
        qp.force_weight * FORCE_UNIT**2,
        TorqueRows(torque.map / LEVER_UNIT, torque.lower / unit, torque.upper / unit),
        qp.joint,
    )
