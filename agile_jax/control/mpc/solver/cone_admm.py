"""First pass: ADMM over friction cones alone, in wrench space.

    minimise    1/2 y' H y + h' y + w/2 |g|^2        y_k = B_k g_k,  k = 0..N-1
    subject to  g in the friction cones

y_k (6,) is the acceleration that the forces g_k (12,) of node k give to the body. Its dynamics are six identical
double integrators, so H depends on weights and time step only and is inverted once, in float64. With the splitting g =
z, z in the cones (Boyd et al. 2011, section 3; over-relaxation section 3.4.3), an iteration solves (w + rho) g + B'(H B
g + h) = rho (z - u). By the matrix inversion lemma that is a system of 6N equations, the same in every iteration:

    (H^-1 + blkdiag(B_k B_k') / (w + rho)) v = H^-1 h + B rhs / (w + rho),   rhs = rho (z - u)
    g = (rhs - B' v) / (w + rho)

Iterations are accelerated after Anderson (Walker and Ni 2011) with the last two changes of z + u.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.control.mpc.problem import MpcConstants
from agile_jax.control.mpc.solver.projection import ConeProjection
from agile_jax.control.mpc.solver.scaled_qp import ScaledQp, batched_matvec

FORCE_PENALTY = 0.2  # rho
OVER_RELAXATION = 1.8
ANDERSON_RIDGE = 1e-6  # of the acceleration's least squares, relative
CHECK_INTERVAL = 5  # iterations between two looks at the residuals


class Iterate(NamedTuple):
    """Feasible forces of one problem, the multipliers of the cones, and how far from optimal they are."""

    forces: Float[Array, "N 4 3"]  # z
    multipliers: Float[Array, "N 4 3"]  # rho u
    primal: Float[Array, ""]  # largest |g - z|
    dual: Float[Array, ""]  # largest rho |z - z_before| / (w + rho)


class ConeSystem(NamedTuple):
    """What all iterations of a batch share."""

    inverse: Float[Array, "batch W W"]  # of the system
    offset: Float[Array, "N 6 batch"]  # H^-1 h


def factorise(constants: MpcConstants, qp: ScaledQp) -> tuple[jax.Array, jax.Array]:
    """`ConeSystem` of one problem."""
    nodes = len(qp.linear)
    force_map = qp.force_map.reshape(nodes, 6, 12)
    blocks = jnp.einsum("kif,kjf->kij", force_map, force_map) / (qp.force_weight + FORCE_PENALTY)
    node = jnp.arange(nodes)
    matrix = constants.hessian_inverse.reshape(nodes, 6, nodes, 6).at[node, :, node, :].add(blocks)
    factor = jax.lax.linalg.cholesky(matrix.reshape(6 * nodes, 6 * nodes), symmetrize_input=False)
    inverse = jax.scipy.linalg.cho_solve((factor, True), jnp.eye(6 * nodes, dtype=matrix.dtype))
    return inverse, (constants.hessian_inverse @ qp.linear.reshape(-1)).reshape(nodes, 6)


def iterate(
    qp: ScaledQp, system: ConeSystem, projection: ConeProjection, forces: jax.Array, multipliers: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """One iteration of a batch: the new forces and multipliers, and the forces g before the projection."""
    diagonal = qp.force_weight + FORCE_PENALTY
    rhs = FORCE_PENALTY * forces - multipliers
    wrench = qp.wrench(rhs)
    multiplier = batched_matvec(system.inverse, system.offset + wrench / diagonal)
    free = (rhs - qp.wrench_transposed(multiplier)) / diagonal
    relaxed = OVER_RELAXATION * free + (1 - OVER_RELAXATION) * forces
    new = qp.project(projection, relaxed + multipliers / FORCE_PENALTY)
    return new, multipliers + FORCE_PENALTY * (relaxed - new), free


class Accelerated(NamedTuple):
    """Where the fixed-point iteration v -> v + f(v) of v = z + u is, and its last two changes."""

    v: Float[Array, "N 4 3 batch"]  # as all others
    v_before: jax.Array
    f_before: jax.Array
    dv: jax.Array  # change of v before the last one
    df: jax.Array  # of f


def accelerate(
    qp: ScaledQp, system: ConeSystem, projection: ConeProjection, at: Accelerated
) -> tuple[Accelerated, Iterate]:
    """One iteration and a step of Anderson acceleration; the iterate is that of the iteration alone."""
    forces = qp.project(projection, at.v)
    new, multipliers, free = iterate(qp, system, projection, forces, FORCE_PENALTY * (at.v - forces))
    f = new + multipliers / FORCE_PENALTY - at.v
    dv, df = at.v - at.v_before, f - at.f_before
    # The combination of both changes that makes f smallest, by the normal equations of two unknowns.
    aa, ab, bb, af, bf = inner(df, df), inner(df, at.df), inner(at.df, at.df), inner(df, f), inner(at.df, f)
    ridge = ANDERSON_RIDGE * (aa + bb) + 1e-12
    aa, bb = aa + ridge, bb + ridge
    determinant = aa * bb - ab * ab
    first, second = (bb * af - ab * bf) / determinant, (aa * bf - ab * af) / determinant
    v = at.v + f - first * (dv + df) - second * (at.dv + at.df)
    change = jnp.abs(new - forces).max((0, 1, 2)) * FORCE_PENALTY / (qp.force_weight + FORCE_PENALTY)
    return Accelerated(v, at.v, f, dv, df), Iterate(new, multipliers, jnp.abs(free - new).max((0, 1, 2)), change)


def inner(a: jax.Array, b: jax.Array) -> jax.Array:
    """Inner product of two arrays (N, 4, 3, batch) of each problem. Shape (batch,)."""
    return (a * b).sum((0, 1, 2))


def solve_cones(
    constants: MpcConstants,
    qps: ScaledQp,
    projection: ConeProjection,
    forces: jax.Array,
    multipliers: jax.Array,
    iterations: int,
    tolerance: float,
) -> Iterate:
    """Iterate on a batch of problems, whose axis is the last one of every array, until all are solved.

    A problem that is solved stays as it is while others go on.

    Args:
        constants: of the controller.
        qps: the problems; their limits of torques and joints are not read.
        projection: onto cones.
        forces, multipliers: where to begin, shape (N, 4, 3, batch) each.
        iterations: at most; looked at after every `CHECK_INTERVAL`.
        tolerance: of forces.
    """
    system = ConeSystem(*jax.vmap(factorise, (None, -1), (0, -1))(constants, qps))
    chunk = min(CHECK_INTERVAL, iterations)

    def unfinished(found: Iterate) -> jax.Array:
        return jnp.maximum(found.primal, found.dual) > tolerance  # a residual that is not a number ends it

    def step(at: Accelerated, _: None) -> tuple[Accelerated, None]:
        return accelerate(qps, system, projection, at)[0], None

    def go_on(carry: tuple[Accelerated, Iterate, jax.Array]) -> tuple[Accelerated, Iterate, jax.Array]:
        at, found, done = carry
        at, new = accelerate(qps, system, projection, jax.lax.scan(step, at, None, length=chunk - 1)[0])
        return at, jax.tree.map(partial(jnp.where, unfinished(found)), new, found), done + chunk

    v = forces + multipliers / FORCE_PENALTY
    first = accelerate(qps, system, projection, Accelerated(v, v, 0 * v, 0 * v, 0 * v))[0]
    unknown = jnp.full(v.shape[-1:], jnp.inf, v.dtype)
    found = Iterate(forces, multipliers, unknown, unknown)
    # Two points make a change: the first step is an iteration alone.
    carry = Accelerated(v + first.f_before, v, first.f_before, 0 * v, 0 * v), found, jnp.int32(0)
    return jax.lax.while_loop(lambda carry: (carry[2] < iterations) & unfinished(carry[1]).any(), go_on, carry)[1]
