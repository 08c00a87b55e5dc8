"""First pass: ADMM over friction cones alone, in wrench space.

    minimise    1/2 y' H y + h' y + w/2 |g|^2        y_k = B_k g_k,  k = 0..N-1
    subject to  g in the friction cones

y_k (6,) is the acceleration that the forces g_k (12,) of node k give to the body. Its dynamics are six identical
double integrators, so H depends on weights and time step only and is inverted once, in float64. With the splitting g =
z, z in the cones (Boyd et al. 2011, section 3; over-relaxation section 3.4.3), an iteration solves (w + rho) g + B'(H B
g + h) = rho (z - u). By the matrix inversion lemma that is a system of 6N equations, the same in every iteration:

    (H^-1 + blkdiag(B_k B_k') / (w + rho)) v = H^-1 h + B rhs / (w + rho),   rhs = rho (z - u)
    g = (rhs - B' v) / (w + rho)
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control.mpc import MpcConstants
from agile_jax.control.scaled_qp import Projection, ScaledQp, times

PENALTY = 0.2  # rho; decides the speed of convergence, measured on problems of a walk
OVER_RELAXATION = 1.8


class Iterate(NamedTuple):
    """Feasible forces, the price of the cones, and how far from optimal they are."""

    forces: jax.Array  # (N, 4, 3) z
    price: jax.Array  # (N, 4, 3) rho u
    primal: jax.Array  # () largest |g - z|
    dual: jax.Array  # () largest rho |z - z_before| / (w + rho)


class Factors(NamedTuple):
    """What all iterations share."""

    inverse: jax.Array  # (batch, 6N, 6N) of the system
    offset: jax.Array  # (N, 6, batch) H^-1 h


def factorise(constants: MpcConstants, qp: ScaledQp) -> tuple[jax.Array, jax.Array]:
    """`Factors` of one problem."""
    nodes = len(qp.linear)
    force_map = qp.force_map.reshape(nodes, 6, 12)
    blocks = jnp.einsum("kif,kjf->kij", force_map, force_map) / (qp.force_weight + PENALTY)
    node = jnp.arange(nodes)
    system = constants.hessian_inverse.reshape(nodes, 6, nodes, 6).at[node, :, node, :].add(blocks)
    factor = jax.lax.linalg.cholesky(system.reshape(6 * nodes, 6 * nodes), symmetrize_input=False)
    inverse = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(6 * nodes, dtype=system.dtype))
    return inverse, (constants.hessian_inverse @ qp.linear.reshape(-1)).reshape(nodes, 6)


def iterate(
    qp: ScaledQp, factors: Factors, shape: Projection, forces: jax.Array, price: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """One iteration of a batch: the new forces and price, and the forces g before the projection."""
    diagonal = qp.force_weight + PENALTY
    rhs = PENALTY * forces - price
    wrench = qp.wrench(rhs)
    multiplier = times(factors.inverse, factors.offset + wrench / diagonal)
    free = (rhs - qp.wrench_transposed(multiplier)) / diagonal
    relaxed = OVER_RELAXATION * free + (1 - OVER_RELAXATION) * forces
    new = qp.project(shape, relaxed + price / PENALTY)
    return new, price + PENALTY * (relaxed - new), free


def solve_cones(
    constants: MpcConstants,
    qps: ScaledQp,
    shape: Projection,
    forces: jax.Array,
    price: jax.Array,
    iterations: int,
) -> Iterate:
    """Run a fixed number of iterations on a batch of problems, whose axis is the last one of every array.

    Args:
        constants: of the controller.
        qps: the problems; their limits of torques and joints are not read.
        shape: projection onto cones.
        forces, price: where to begin, shape (N, 4, 3, batch) each.
        iterations: fixed count.
    """
    factors = Factors(*jax.vmap(factorise, (None, -1), (0, -1))(constants, qps))

    def step(carry: tuple[jax.Array, jax.Array], _: None) -> tuple[tuple[jax.Array, jax.Array], None]:
        return iterate(qps, factors, shape, *carry)[:2], None

    before, _ = jax.lax.scan(step, (forces, price), None, length=iterations - 1)
    new, price, free = iterate(qps, factors, shape, *before)
    change = jnp.abs(new - before[0]).max((0, 1, 2)) * PENALTY / (qps.force_weight + PENALTY)
    return Iterate(new, price, jnp.abs(free - new).max((0, 1, 2)), change)
