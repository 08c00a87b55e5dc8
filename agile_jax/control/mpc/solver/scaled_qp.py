"""The quadratic program of the MPC in units in which float32 suffices: forces of 30 N, torques of 30 N x 0.2 m.

Arrays are indexed from the front, so everything here also takes a batch whose axis is the last one of every array:
shapes (..., batch). Products are sums over the contracted index written out; each term is then one vector operation
over the problems. (vmap would put the batch first, and XLA's products of many small matrices take three times as long.)
"""

from collections.abc import Iterable
from functools import reduce
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.control.mpc.leg_limits import JointRows, TorqueRows
from agile_jax.control.mpc.problem import MpcConstants, Qp
from agile_jax.control.mpc.solver.projection import ConeProjection

FORCE_UNIT = 30.0  # [N], about a quarter of the robot's weight
LEVER_UNIT = 0.2  # [m], about a joint's lever arm: a row of torque has about the length of a row of force


class ScaledQp(NamedTuple):
    """minimise 1/2 y' H y + h' y + w/2 |g|^2 over g = f / FORCE_UNIT, y_k = B_k g_k; fields as in `Qp`."""

    linear: Float[Array, "N 6"]
    force_map: Float[Array, "N 6 4 3"]  # zero for a foot in the air
    contact: Float[Array, "N 4"]
    friction: Float[Array, ""]
    force_max: Float[Array, ""]
    force_weight: Float[Array, ""]
    torque: TorqueRows
    joint: JointRows

    def wrench(self, forces: jax.Array) -> jax.Array:
        """B times the forces (N, 4, 3). Shape (N, 6)."""
        return _sum(self.force_map[:, :, leg, i] * forces[:, leg, i, None] for leg in range(4) for i in range(3))

    def wrench_transposed(self, multiplier: jax.Array) -> jax.Array:
        """B' times (N, 6). Shape (N, 4, 3)."""
        return _sum(self.force_map[:, axis] * multiplier[:, axis, None, None] for axis in range(6))

    def torques(self, forces: jax.Array) -> jax.Array:
        """What the rows of torque limit. Shape (N, 4, 3)."""
        return _sum(self.torque.map[:, :, :, i] * forces[:, :, None, i] for i in range(3))

    def torques_transposed(self, rows: jax.Array) -> jax.Array:
        """The transpose of `torques`. Shape (N, 4, 3)."""
        return _sum(self.torque.map[:, :, i] * rows[:, :, i, None] for i in range(3))

    def joints(self, constants: MpcConstants, wrench: jax.Array) -> jax.Array:
        """What the rows of the joints' positions limit. Shape (N, 12)."""
        position = jnp.tensordot(constants.response, wrench, 1)
        return _sum(self.joint.map[:, :, axis] * position[:, axis, None] for axis in range(6))

    def joints_transposed(self, constants: MpcConstants, rows: jax.Array) -> jax.Array:
        """The transpose of `joints`. Shape (N, 12) to (N, 6)."""
        rows = _sum(self.joint.map[:, i] * rows[:, i, None] for i in range(12))
        return jnp.tensordot(constants.response.T, rows, 1)

    def gradient(self, constants: MpcConstants, wrench: jax.Array) -> jax.Array:
        """H y + h. Shape (N, 6)."""
        flat = wrench.reshape(len(constants.hessian), *wrench.shape[2:])
        return jnp.tensordot(constants.hessian, flat, 1).reshape(wrench.shape) + self.linear

    def project(self, projection: ConeProjection, forces: jax.Array) -> jax.Array:
        """Nearest forces (N, 4, 3) that the feet can have, limits of joints aside."""
        return projection(forces, self.friction, self.force_max) * self.contact[:, :, None]


def scale(qp: Qp) -> ScaledQp:
    """Change the units, and take the forces of feet in the air out of the dynamics."""
    nodes = len(qp.linear)
    torque, unit = qp.torque, FORCE_UNIT * LEVER_UNIT
    return ScaledQp(
        qp.linear,
        qp.force_map.reshape(nodes, 6, 4, 3) * FORCE_UNIT * qp.contact[:, None, :, None],
        qp.contact,
        qp.friction,
        qp.force_max / FORCE_UNIT,
        qp.force_weight * FORCE_UNIT**2,
        TorqueRows(torque.map / LEVER_UNIT, torque.lower / unit, torque.upper / unit),
        qp.joint,
    )


def foot_matvec(matrices: jax.Array, vectors: jax.Array) -> jax.Array:
    """A matrix of each foot times its vector. Shapes (N, 4, 3, 3), (N, 4, 3) to (N, 4, 3)."""
    return _sum(matrices[:, :, :, i] * vectors[:, :, None, i] for i in range(3))


def batched_matvec(matrices: jax.Array, wrench: jax.Array) -> jax.Array:
    """A matrix of each problem times its wrench. Shapes (batch, 6N, 6N), (N, 6, batch) to (N, 6, batch).

    The product with the identity is a hint to the compiler: without it, the sums that make `wrench` are fused with the
    transposition that the batched product needs and computed one problem at a time, a third slower in all.
    """
    flat = wrench.reshape(-1, wrench.shape[-1])
    flat = jnp.tensordot(jnp.eye(len(flat)), flat, 1)
    return jnp.einsum("bij,jb->ib", matrices, flat).reshape(wrench.shape)


def _sum(terms: Iterable[jax.Array]) -> jax.Array:
    return reduce(add, terms)
