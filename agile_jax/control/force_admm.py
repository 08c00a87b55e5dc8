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

from agile_jax.control.scaled_qp import Projection, ScaledQp

PENALTY = 0.2  # rho; decides the speed of convergence, measured on problems of a walk
OVER_RELAXATION = 1.8


class Iterate(NamedTuple):
    """Feasible forces, the price of the cones, and how far from optimal they are."""

    forces: jax.Array  # (N, 4, 3) z
    price: jax.Array  # (N, 4, 3) rho u
    primal: jax.Array  # () largest |g - z|
    dual: jax.Array  # () largest rho |z - z_before| / (w + rho)


def solve_cones(qp: ScaledQp, project: Projection, forces: jax.Array, price: jax.Array, iterations: int) -> Iterate:
    """Run a fixed number of iterations.

    Args:
        qp: the problem; its limits of torques and joints are not read.
        project: onto the cones.
        forces, price: where to begin, shape (N, 4, 3) each.
        iterations: fixed count.
    """
    nodes = len(qp.linear)
    diagonal = qp.force_weight + PENALTY
    blocks = jnp.einsum("kif,kjf->kij", qp.force_map, qp.force_map) / diagonal  # (N, 6, 6)
    node = jnp.arange(nodes)
    system = qp.hessian_inverse.reshape(nodes, 6, nodes, 6).at[node, :, node, :].add(blocks).reshape(6 * nodes, -1)
    factor = jax.lax.linalg.cholesky(system, symmetrize_input=False)
    inverse = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(6 * nodes, dtype=system.dtype))
    offset = qp.hessian_inverse @ qp.linear.reshape(-1)

    def step(carry: Iterate, _: None) -> tuple[Iterate, None]:
        rhs = PENALTY * carry.forces - carry.price
        wrench = qp.wrench(rhs).reshape(-1) / diagonal
        multiplier = (inverse @ (offset + wrench)).reshape(nodes, 6)
        free = (rhs - qp.wrench_transposed(multiplier)) / diagonal
        relaxed = OVER_RELAXATION * free + (1 - OVER_RELAXATION) * carry.forces
        new = project(relaxed + carry.price / PENALTY)
        price = carry.price + PENALTY * (relaxed - new)
        change = jnp.abs(new - carry.forces).max() * PENALTY / diagonal
        return Iterate(new, price, jnp.abs(free - new).max(), change), None

    unknown = jnp.full((), jnp.inf, forces.dtype)
    end, _ = jax.lax.scan(step, Iterate(forces, price, unknown, unknown), None, length=iterations)
    return end
