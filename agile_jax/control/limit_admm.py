"""Second pass: ADMM over friction cones, torque limits and joint limits, in wrench space.

    minimise    1/2 y' H y + h' y + w/2 |g|^2        y = B g
    subject to  g in the friction cones,  A g in the box of torques,  K y in the box of joint positions

Three splittings, g = z, A g = t, K y = s, with penalties rho, rho_t, rho_s and scaled duals u, v, q. Torques belong to
one foot and positions to the wrench, so the structure of the first pass stays:

    D = (w + rho) 1 + rho_t A' A              3 x 3 for each foot
    H' = H + rho_s K' K = L L'                6N x 6N
    (D + B' H' B)^-1 = D^-1 - D^-1 B' P B D^-1,    P = (H'^-1 + S)^-1 = L (1 + L' S L)^-1 L',    S = B D^-1 B'

Two factorisations of 6N x 6N make P; then an iteration is a Newton step on the augmented Lagrangian, which is
quadratic in g: dg = -(D + B' H' B)^-1 r. That r is the gradient at the present g, not a right-hand side of offsets,
keeps rounding errors out of the fixed point: float32 then gives 1e-3 N where the direct form gave 0.1 N.

Joint positions are limited by an exact penalty, c |K y - box|_1 (Nocedal and Wright 2006, section 17.2): as long as
their multipliers stay below c the limits are hard, and where no force can keep them the solution is the one that
violates them least, instead of none. Its proximal operator only bounds the duals: |rho_s q| <= c.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control.force_admm import Iterate
from agile_jax.control.leg_limits import inverse_3x3
from agile_jax.control.scaled_qp import Projection, ScaledQp

# Penalties and over-relaxation, measured on problems with active torque and joint limits.
PENALTY = 0.3  # rho
TORQUE_PENALTY = 0.1  # rho_t
JOINT_PENALTY = 10.0  # rho_s [1/rad^2]
OVER_RELAXATION = 1.8
JOINT_PRICE_MAX = 100.0  # c [1/rad]
CHUNK = 10  # iterations between two looks at the residuals


class State(NamedTuple):
    """Iterates; what follows from g is kept beside it."""

    g: jax.Array  # (N, 4, 3)
    wrench: jax.Array  # (N, 6) B g
    torques: jax.Array  # (N, 4, 3) A g
    joints: jax.Array  # (N, 12) K B g
    z: jax.Array  # (N, 4, 3)
    u: jax.Array  # (N, 4, 3)
    t: jax.Array  # (N, 4, 3)
    v: jax.Array  # (N, 4, 3)
    s: jax.Array  # (N, 12)
    q: jax.Array  # (N, 12)
    primal: jax.Array  # ()
    dual: jax.Array  # ()
    done: jax.Array  # () int32, iterations


class Factors(NamedTuple):
    """What all iterations share."""

    foot: jax.Array  # (N, 4, 3, 3) D^-1
    wrench_foot: jax.Array  # (N, 6, 12) B D^-1
    P: jax.Array  # (6N, 6N)


def factorise(qp: ScaledQp) -> Factors:
    """The two factorisations."""
    nodes = len(qp.linear)
    rows = qp.torque.map
    foot = inverse_3x3((qp.force_weight + PENALTY) * jnp.eye(3) + TORQUE_PENALTY * jnp.swapaxes(rows, -1, -2) @ rows)
    wrench_foot = jnp.einsum("kalj,kljm->kalm", qp.force_map.reshape(nodes, 6, 4, 3), foot).reshape(nodes, 6, 12)
    S = jnp.einsum("kai,kbi->kab", wrench_foot, qp.force_map)
    weights = JOINT_PENALTY * jnp.einsum("kia,kib->kab", qp.joint.map, qp.joint.map)  # (N, 6, 6)
    pairs = jnp.einsum("ki,kj->kij", qp.response, qp.response).reshape(nodes, nodes**2)  # constant
    hessian = (pairs.T @ weights.reshape(nodes, 36)).reshape(nodes, nodes, 6, 6).transpose(0, 2, 1, 3)
    axis = jnp.arange(6)
    hessian = hessian.at[:, axis, :, axis].add(qp.hessian).reshape(6 * nodes, 6 * nodes)
    L = jax.lax.linalg.cholesky(hessian, symmetrize_input=False)
    SL = (S @ L.reshape(nodes, 6, 6 * nodes)).reshape(6 * nodes, 6 * nodes)
    R = jax.lax.linalg.cholesky(L.T @ SL + jnp.eye(6 * nodes), symmetrize_input=False)
    X = jax.lax.linalg.triangular_solve(R, L.T, left_side=True, lower=True)
    return Factors(foot, wrench_foot, X.T @ X)


def solve_limits(
    qp: ScaledQp, project: Projection, start: Iterate, iterations: int, tolerance: float, joint_tolerance: float
) -> tuple[Iterate, jax.Array]:
    """Iterate until the residuals are below their tolerances.

    Args:
        qp: the problem.
        project: onto the cones.
        start: from the first pass.
        iterations: at most; looked at after every `CHUNK`.
        tolerance: of forces, and of torques in units of force.
        joint_tolerance: of positions [rad].

    Returns:
        The last iterate, and the number of iterations (), int32.
    """
    factors = factorise(qp)

    def step(state: State, _: None) -> tuple[State, None]:
        joint_rest = JOINT_PENALTY * (state.joints - state.s + state.q)
        multiplier = qp.gradient(state.wrench) + qp.joints_transposed(joint_rest)
        torque_rest = TORQUE_PENALTY * (state.torques - state.t + state.v)
        residual = (
            qp.force_weight * state.g + qp.wrench_transposed(multiplier) + PENALTY * (state.g - state.z + state.u)
        )
        residual += jnp.einsum("klij,kli->klj", qp.torque.map, torque_rest)
        b = jnp.einsum("kai,ki->ka", factors.wrench_foot, residual.reshape(-1, 12))
        rise = (factors.P @ b.reshape(-1)).reshape(-1, 6)
        change = jnp.einsum("klij,klj->kli", factors.foot, qp.wrench_transposed(rise) - residual)

        g = state.g + change
        wrench = qp.wrench(g)
        torques, joints = qp.torques(g), qp.joints(wrench)
        z_relaxed = relax(g, state.z) + state.u
        z = project(z_relaxed)
        t_relaxed = relax(torques, state.t) + state.v
        t = jnp.clip(t_relaxed, qp.torque.lower, qp.torque.upper)
        s_relaxed = relax(joints, state.s) + state.q
        outside = s_relaxed - jnp.clip(s_relaxed, qp.joint.lower, qp.joint.upper)
        q = jnp.clip(outside, -JOINT_PRICE_MAX / JOINT_PENALTY, JOINT_PRICE_MAX / JOINT_PENALTY)
        s = s_relaxed - q
        to_force = tolerance / joint_tolerance
        primal = largest(g - z, torques - t, (joints - s) * to_force)
        dual = largest(z - state.z, t - state.t, (s - state.s) * to_force)
        return State(
            g, wrench, torques, joints, z, z_relaxed - z, t, t_relaxed - t, s, q, primal, dual, state.done + 1
        ), None

    def chunk(state: State) -> State:
        return jax.lax.scan(step, state, None, length=CHUNK)[0]

    def unfinished(state: State) -> jax.Array:
        residual = jnp.maximum(state.primal, state.dual)
        return (state.done < iterations) & ~(residual <= tolerance) & jnp.isfinite(residual)

    g = start.forces
    wrench = qp.wrench(g)
    torques, joints = qp.torques(g), qp.joints(wrench)
    t, s = jnp.clip(torques, qp.torque.lower, qp.torque.upper), jnp.clip(joints, qp.joint.lower, qp.joint.upper)
    zero = jnp.zeros((), g.dtype)
    begin = State(g, wrench, torques, joints, g, start.price / PENALTY, t, 0 * t, s, 0 * s, zero, zero, jnp.int32(0))
    end = jax.lax.while_loop(unfinished, chunk, chunk(begin))
    return Iterate(end.z, PENALTY * end.u, end.primal, end.dual), end.done


def relax(new: jax.Array, old: jax.Array) -> jax.Array:
    """Over-relaxation."""
    return OVER_RELAXATION * new + (1 - OVER_RELAXATION) * old


def largest(*residuals: jax.Array) -> jax.Array:
    """Largest absolute entry."""
    return jnp.stack([jnp.abs(residual).max() for residual in residuals]).max()
