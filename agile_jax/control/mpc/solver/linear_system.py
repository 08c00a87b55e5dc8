"""The linear system behind forces under cones, torque limits and joint limits, in wrench space.

With quadratic penalties on cones, torques A g and joint positions K y, y = B g, the Hessian of the augmented Lagrangian
is D + B' (H + K' W K) B: D has a 3 x 3 block for each foot, W is diagonal. Torques belong to one foot and positions to
the wrench, so a system of 6N equations is all there is to factorise:

    H' = H + K' W K = L L'
    (D + B' H' B)^-1 = D^-1 - D^-1 B' P B D^-1,    P = (H'^-1 + S)^-1 = L (1 + L' S L)^-1 L',    S = B D^-1 B'

ADMM forms P once and multiplies with it in every iteration; a Newton step solves with the factors. Both apply the
inverse to the gradient at the present forces, not to a right-hand side of offsets: that keeps rounding errors out of
where they end. float32 then gives 1e-3 N where the direct form gave 0.1 N.
"""

from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.control.mpc.problem import MpcConstants
from agile_jax.control.mpc.solver.scaled_qp import ScaledQp, foot_matvec
from agile_jax.geometry import inverse_3x3


class Multipliers(NamedTuple):
    """Multipliers (dual variables) of cones and limits, in units of the objective per unit of the limited quantity."""

    cone: Float[Array, "N 4 3"]
    torque: Float[Array, "N 4 3"]
    joint: Float[Array, "N 12"]


class Factors(NamedTuple):
    """Factors of one system; in a batch, matrices have the batch first and D^-1 has it last."""

    L: Float[Array, "W W"]
    R: Float[Array, "W W"]  # R R' = 1 + L' S L
    foot: Float[Array, "N 4 3 3"]  # D^-1


BATCHED = Factors(0, 0, -1)  # type: ignore[arg-type]  # axes of a batch


def factorise(constants: MpcConstants, qp: ScaledQp, foot: jax.Array, joint_weight: jax.Array) -> Factors:
    """The system of one problem (arrays without the batch axis).

    Args:
        constants, qp: the problem.
        foot: D, shape (N, 4, 3, 3).
        joint_weight: W, shape (N, 12).
    """
    nodes = len(qp.linear)
    foot = inverse_3x3(foot, jnp)
    wrench_foot = jnp.stack([foot_matvec(foot, qp.force_map[:, axis]) for axis in range(6)], 1)  # B D^-1
    S = jnp.einsum("kif,kjf->kij", wrench_foot.reshape(nodes, 6, 12), qp.force_map.reshape(nodes, 6, 12))
    weights = jnp.einsum("kia,ki,kib->kab", qp.joint.map, joint_weight, qp.joint.map)  # (N, 6, 6)
    pairs = jnp.einsum("ki,kj->kij", constants.response, constants.response).reshape(nodes, nodes**2)
    joint = (pairs.T @ weights.reshape(nodes, 36)).reshape(nodes, nodes, 6, 6).transpose(0, 2, 1, 3)
    L = jax.lax.linalg.cholesky(constants.hessian + joint.reshape(6 * nodes, 6 * nodes), symmetrize_input=False)
    SL = (S @ L.reshape(nodes, 6, 6 * nodes)).reshape(6 * nodes, 6 * nodes)
    R = jax.lax.linalg.cholesky(L.T @ SL + jnp.eye(6 * nodes), symmetrize_input=False)
    return Factors(L, R, foot)


def inverse(factors: Factors) -> jax.Array:
    """P of one system, shape (6N, 6N)."""
    X = jax.lax.linalg.triangular_solve(factors.R, factors.L.T, left_side=True, lower=True)
    return X.T @ X


def solve(factors: Factors, wrench: jax.Array) -> jax.Array:
    """P times a wrench, of one system. Shape (N, 6)."""
    flat = factors.L.T @ wrench.reshape(-1)
    return (factors.L @ jax.scipy.linalg.cho_solve((factors.R, True), flat)).reshape(wrench.shape)


def newton_step(
    qp: ScaledQp, foot: jax.Array, apply_P: Callable[[jax.Array], jax.Array], gradient: jax.Array
) -> jax.Array:
    """Change of the forces that makes the gradient zero, in a batch.

    Args:
        qp: the problems.
        foot: D^-1, shape (N, 4, 3, 3, batch).
        apply_P: multiplies wrenches, shape (N, 6, batch), with P.
        gradient: shape (N, 4, 3, batch), as the result.
    """
    rise = apply_P(qp.wrench(foot_matvec(foot, gradient)))
    return foot_matvec(foot, qp.wrench_transposed(rise) - gradient)


def lagrangian_gradient(
    constants: MpcConstants, qp: ScaledQp, forces: jax.Array, wrench: jax.Array, multipliers: Multipliers
) -> jax.Array:
    """Gradient of the Lagrangian by the forces, in a batch. Shape (N, 4, 3)."""
    multiplier = qp.gradient(constants, wrench) + qp.joints_transposed(constants, multipliers.joint)
    gradient = qp.force_weight * forces + qp.wrench_transposed(multiplier) + multipliers.cone
    return gradient + qp.torques_transposed(multipliers.torque)


def largest(*residuals: jax.Array) -> jax.Array:
    """Largest absolute entry of each problem."""
    return reduce(jnp.maximum, (jnp.abs(part).max(tuple(range(part.ndim - 1))) for part in residuals))
