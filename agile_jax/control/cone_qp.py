"""The quadratic program of convex MPC over friction cones, solved by ADMM in wrench space.

    minimise    1/2 y' H y + h' y + w/2 |f|^2        y_k = B_k f_k,  k = 0..N-1
    subject to  |f_xy| <= mu f_z,  0 <= f_z <= f_max   for each standing foot,   f = 0 for each swinging foot

y_k (6,) is the acceleration that the forces f_k (12,) of node k give to the body. Its dynamics are six identical
double integrators, so H depends on weights and time step only and is inverted once, in float64. With the splitting f
= z, z in the cones (Boyd et al. 2011, section 3; over-relaxation section 3.4.3), an iteration solves (w + rho) f +
B'(H B f + h) = rho (z - u). By the matrix inversion lemma that is a system of 6N equations, the same in every
iteration:

    (H^-1 + blkdiag(B_k B_k') / (w + rho)) v = H^-1 h + B rhs / (w + rho),   rhs = rho (z - u)
    f = (rhs - B' v) / (w + rho)

The projection onto the cone is exact. Forces are scaled by `FORCE_UNIT` so that float32 suffices.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

FORCE_UNIT = 30.0  # [N], about a quarter of the robot's weight
PENALTY = 0.2  # rho in scaled units; decides the speed of convergence, measured on problems of a walk
OVER_RELAXATION = 1.6


class Qp(NamedTuple):
    """One problem. N nodes, 4 feet; forces in [N], accelerations in [m/s^2], [rad/s^2]."""

    hessian_inverse: jax.Array  # (6N, 6N), ordered by node, then axis
    linear: jax.Array  # (N, 6) h
    force_map: jax.Array  # (N, 6, 12) B_k
    contact: jax.Array  # (N, 4) 1 where the foot stands, else 0
    friction: jax.Array  # () mu
    force_max: jax.Array  # () [N]
    force_weight: jax.Array  # () w


class WarmStart(NamedTuple):
    """Iterates of the solver, scaled."""

    projected: jax.Array  # (N, 12) z
    dual: jax.Array  # (N, 12) u


class QpSolution(NamedTuple):
    """Forces inside their cones, and how far from optimal they are."""

    forces: jax.Array  # (N, 12) [N], feasible to the last bit: they are the projected iterate
    primal_residual: jax.Array  # () largest |f - z| [N]
    dual_residual: jax.Array  # () largest rho |z - z_before| / (w + rho) [N]
    warm_start: WarmStart


def cold_start(nodes: int) -> WarmStart:
    """Zero iterates."""
    return WarmStart(jnp.zeros((nodes, 12)), jnp.zeros((nodes, 12)))


def project(force: jax.Array, contact: jax.Array, friction: jax.Array, force_max: jax.Array) -> jax.Array:
    """Exact Euclidean projection onto {|f_xy| <= mu f_z, 0 <= f_z <= f_max}, or onto zero for a swinging foot.

    Where the projection onto the cone is above f_max, the nearest point of the truncated cone lies on its disc at
    f_max.

    Args:
        force: shape (..., 3).
        contact: shape (...), 1 or 0.
        friction, force_max: scalars.
    """
    tangential, normal = force[..., :2], force[..., 2]
    length = jnp.sqrt(jnp.sum(tangential**2, -1) + 1e-20)
    on_cone = (normal + friction * length) / (1 + friction**2)
    inside = length <= friction * normal
    polar = friction * length <= -normal
    new_normal = jnp.where(inside, normal, jnp.where(polar, 0.0, on_cone))
    new_normal = jnp.clip(new_normal, 0.0, force_max)
    # Inside the cone the tangential part stays; otherwise it is cut to the cone's radius at the new height.
    new_tangential = tangential * jnp.minimum(1.0, friction * new_normal / length)[..., None]
    return jnp.concatenate([new_tangential, new_normal[..., None]], -1) * contact[..., None]


def solve(qp: Qp, start: WarmStart, iterations: int) -> QpSolution:
    """Run a fixed number of ADMM iterations (static shapes, so that problems can be vmapped).

    Args:
        qp: the problem.
        start: iterates to begin from, `cold_start` or those of the previous solution.
        iterations: fixed count.
    """
    nodes = qp.linear.shape[0]
    # Scale: f = FORCE_UNIT * g. The cost in g has B * FORCE_UNIT and w * FORCE_UNIT^2.
    force_map = qp.force_map * FORCE_UNIT * jnp.repeat(qp.contact, 3, -1)[:, None, :]
    weight = qp.force_weight * FORCE_UNIT**2
    diagonal = weight + PENALTY
    force_max = qp.force_max / FORCE_UNIT

    blocks = jnp.einsum("kif,kjf->kij", force_map, force_map) / diagonal  # (N, 6, 6)
    node = jnp.arange(nodes)
    system = qp.hessian_inverse.reshape(nodes, 6, nodes, 6).at[node, :, node, :].add(blocks).reshape(6 * nodes, -1)
    factor = jax.scipy.linalg.cho_factor(system, lower=True)
    inverse = jax.scipy.linalg.cho_solve(factor, jnp.eye(6 * nodes, dtype=system.dtype))
    offset = qp.hessian_inverse @ qp.linear.reshape(-1)

    def step(carry: WarmStart, _: None) -> tuple[WarmStart, tuple[jax.Array, jax.Array]]:
        projected, dual = carry
        rhs = PENALTY * (projected - dual)
        wrench = jnp.einsum("kif,kf->ki", force_map, rhs).reshape(-1) / diagonal
        multiplier = (inverse @ (offset + wrench)).reshape(nodes, 6)
        force = (rhs - jnp.einsum("kif,ki->kf", force_map, multiplier)) / diagonal
        relaxed = OVER_RELAXATION * force + (1 - OVER_RELAXATION) * projected
        candidate = (relaxed + dual).reshape(nodes, 4, 3)
        new = project(candidate, qp.contact, qp.friction, force_max).reshape(nodes, 12)
        residuals = (jnp.abs(force - new).max(), jnp.abs(new - projected).max() * PENALTY / diagonal)
        return WarmStart(new, dual + relaxed - new), residuals

    end, (primal, dual) = jax.lax.scan(step, start, None, length=iterations)
    return QpSolution(end.projected * FORCE_UNIT, primal[-1] * FORCE_UNIT, dual[-1] * FORCE_UNIT, end)
