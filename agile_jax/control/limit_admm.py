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

from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control.force_admm import Iterate
from agile_jax.control.leg_limits import inverse_3x3
from agile_jax.control.mpc import MpcConstants
from agile_jax.control.scaled_qp import Projection, ScaledQp, multiply_3x3, times

# Penalties and over-relaxation, measured on problems with active torque and joint limits.
PENALTY = 0.3  # rho
TORQUE_PENALTY = 0.1  # rho_t
JOINT_PENALTY = 10.0  # rho_s [1/rad^2]
OVER_RELAXATION = 1.8
JOINT_PRICE_MAX = 1000.0  # c [1/rad]
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


class Factors(NamedTuple):
    """What all iterations share."""

    P: jax.Array  # (batch, 6N, 6N)
    foot: jax.Array  # (N, 4, 3, 3, batch) D^-1


def factorise(constants: MpcConstants, qp: ScaledQp) -> tuple[jax.Array, jax.Array]:
    """`Factors` of one problem."""
    nodes = len(qp.linear)
    rows = qp.torque.map
    foot = inverse_3x3((qp.force_weight + PENALTY) * jnp.eye(3) + TORQUE_PENALTY * jnp.swapaxes(rows, -1, -2) @ rows)
    wrench_foot = jnp.stack([multiply_3x3(foot, qp.force_map[:, axis]) for axis in range(6)], 1)  # B D^-1
    S = jnp.einsum("kif,kjf->kij", wrench_foot.reshape(nodes, 6, 12), qp.force_map.reshape(nodes, 6, 12))
    weights = JOINT_PENALTY * jnp.einsum("kia,kib->kab", qp.joint.map, qp.joint.map)  # (N, 6, 6)
    pairs = jnp.einsum("ki,kj->kij", constants.response, constants.response).reshape(nodes, nodes**2)
    joint = (pairs.T @ weights.reshape(nodes, 36)).reshape(nodes, nodes, 6, 6).transpose(0, 2, 1, 3)
    L = jax.lax.linalg.cholesky(constants.hessian + joint.reshape(6 * nodes, 6 * nodes), symmetrize_input=False)
    SL = (S @ L.reshape(nodes, 6, 6 * nodes)).reshape(6 * nodes, 6 * nodes)
    R = jax.lax.linalg.cholesky(L.T @ SL + jnp.eye(6 * nodes), symmetrize_input=False)
    X = jax.lax.linalg.triangular_solve(R, L.T, left_side=True, lower=True)
    return X.T @ X, foot


def begin(constants: MpcConstants, qp: ScaledQp, forces: jax.Array, price: jax.Array) -> State:
    """A batch from forces and the price of their cones; the other prices begin at zero."""
    wrench = qp.wrench(forces)
    torques, joints = qp.torques(forces), qp.joints(constants, wrench)
    t, s = jnp.clip(torques, qp.torque.lower, qp.torque.upper), jnp.clip(joints, qp.joint.lower, qp.joint.upper)
    return State(forces, wrench, torques, joints, forces, price / PENALTY, t, 0 * t, s, 0 * s)


def iterate(constants: MpcConstants, qp: ScaledQp, factors: Factors, shape: Projection, state: State) -> State:
    """One iteration of a batch."""
    joint_rest = JOINT_PENALTY * (state.joints - state.s + state.q)
    multiplier = qp.gradient(constants, state.wrench) + qp.joints_transposed(constants, joint_rest)
    torque_rest = TORQUE_PENALTY * (state.torques - state.t + state.v)
    residual = qp.force_weight * state.g + qp.wrench_transposed(multiplier) + PENALTY * (state.g - state.z + state.u)
    residual += qp.torques_transposed(torque_rest)
    rise = times(factors.P, qp.wrench(multiply_3x3(factors.foot, residual)))
    g = state.g + multiply_3x3(factors.foot, qp.wrench_transposed(rise) - residual)

    wrench = qp.wrench(g)
    torques, joints = qp.torques(g), qp.joints(constants, wrench)
    z_relaxed = relax(g, state.z) + state.u
    z = qp.project(shape, z_relaxed)
    t_relaxed = relax(torques, state.t) + state.v
    t = jnp.clip(t_relaxed, qp.torque.lower, qp.torque.upper)
    s_relaxed = relax(joints, state.s) + state.q
    outside = s_relaxed - jnp.clip(s_relaxed, qp.joint.lower, qp.joint.upper)
    q = jnp.clip(outside, -JOINT_PRICE_MAX / JOINT_PENALTY, JOINT_PRICE_MAX / JOINT_PENALTY)
    return State(g, wrench, torques, joints, z, z_relaxed - z, t, t_relaxed - t, s_relaxed - q, q)


def residuals(old: State, new: State, joint_scale: float) -> tuple[jax.Array, jax.Array]:
    """Primal and dual residuals of a batch, positions of joints times `joint_scale`."""
    primal = largest(new.g - new.z, new.torques - new.t, (new.joints - new.s) * joint_scale)
    return primal, largest(new.z - old.z, new.t - old.t, (new.s - old.s) * joint_scale)


def solve_limits(
    constants: MpcConstants,
    qps: ScaledQp,
    shape: Projection,
    start: Iterate,
    iterations: int,
    tolerance: float,
    joint_tolerance: float,
) -> tuple[Iterate, jax.Array]:
    """Iterate on a batch of problems, whose axis is the last one of every array, until all are solved.

    A problem that is solved stays as it is while others go on.

    Args:
        constants: of the controller.
        qps: the problems.
        shape: projection onto cones.
        start: from the first pass.
        iterations: at most; looked at after every `CHUNK`.
        tolerance: of forces, and of torques in units of force.
        joint_tolerance: of positions [rad].

    Returns:
        The last iterates, and the numbers of iterations (batch,), int32.
    """
    factors = Factors(*jax.vmap(factorise, (None, -1), (0, -1))(constants, qps))

    class Loop(NamedTuple):
        state: State
        primal: jax.Array
        dual: jax.Array
        done: jax.Array

    def chunk(loop: Loop) -> Loop:
        def step(state: State, _: None) -> tuple[State, None]:
            return iterate(constants, qps, factors, shape, state), None

        before, _ = jax.lax.scan(step, loop.state, None, length=CHUNK - 1)
        state = iterate(constants, qps, factors, shape, before)
        following = Loop(state, *residuals(before, state, tolerance / joint_tolerance), loop.done + CHUNK)
        return jax.tree.map(partial(jnp.where, unfinished(loop)), following, loop)

    def unfinished(loop: Loop) -> jax.Array:
        residual = jnp.maximum(loop.primal, loop.dual)
        return (loop.done < iterations) & (residual > tolerance)  # a residual that is not a number ends it

    state = begin(constants, qps, start.forces, start.price)
    unknown = jnp.full(start.primal.shape, jnp.inf, start.primal.dtype)
    end = jax.lax.while_loop(
        lambda loop: unfinished(loop).any(), chunk, Loop(state, unknown, unknown, jnp.zeros(unknown.shape, jnp.int32))
    )
    return Iterate(end.state.z, PENALTY * end.state.u, end.primal, end.dual), end.done


def relax(new: jax.Array, old: jax.Array) -> jax.Array:
    """Over-relaxation."""
    return OVER_RELAXATION * new + (1 - OVER_RELAXATION) * old


def largest(*residuals: jax.Array) -> jax.Array:
    """Largest absolute entry of each problem."""
    return reduce(jnp.maximum, (jnp.abs(part).max(tuple(range(part.ndim - 1))) for part in residuals))
