"""Second pass: ADMM over friction cones, torque limits and joint limits, in wrench space.

    minimise    1/2 y' H y + h' y + w/2 |g|^2        y = B g
    subject to  g in the friction cones,  A g in the box of torques,  K y in the box of joint positions

Three splittings, g = z, A g = t, K y = s, with penalties rho, rho_t, rho_s and scaled multipliers u, v, q. The
augmented Lagrangian is quadratic in g, so an iteration is one Newton step (`linear_system`) with D = (w + rho) 1 +
rho_t A' A and W = rho_s 1, factorised once.

Joint positions are limited by an exact penalty, c |K y - box|_1 (Nocedal and Wright 2006, section 17.2): as long as
their multipliers stay below c the limits are hard, and where no force can keep them the solution is the one that
violates them least, instead of none. Its proximal operator only bounds the multipliers: |rho_s q| <= c.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from agile_jax.control.mpc.problem import MpcConstants
from agile_jax.control.mpc.solver.cone_admm import Iterate
from agile_jax.control.mpc.solver.linear_system import (
    Multipliers,
    factorise,
    inverse,
    lagrangian_gradient,
    largest,
    newton_step,
)
from agile_jax.control.mpc.solver.projection import ConeProjection
from agile_jax.control.mpc.solver.scaled_qp import ScaledQp, batched_matvec

FORCE_PENALTY = 0.3  # rho
TORQUE_PENALTY = 0.1  # rho_t
JOINT_PENALTY = 10.0  # rho_s [1/rad^2]
OVER_RELAXATION = 1.8
JOINT_MULTIPLIER_MAX = 1000.0  # c [1/rad]
CHECK_INTERVAL = 10  # iterations between two looks at the residuals


class Splitting(NamedTuple):
    """Iterates of a problem, with the names of the module's docstring; what follows from g is kept beside it."""

    g: Float[Array, "N 4 3"]
    wrench: Float[Array, "N 6"]  # B g
    torques: Float[Array, "N 4 3"]  # A g
    joints: Float[Array, "N 12"]  # K B g
    z: Float[Array, "N 4 3"]
    u: Float[Array, "N 4 3"]
    t: Float[Array, "N 4 3"]
    v: Float[Array, "N 4 3"]
    s: Float[Array, "N 12"]
    q: Float[Array, "N 12"]


class LimitSystem(NamedTuple):
    """What all iterations of a batch share."""

    P: Float[Array, "batch W W"]  # of `linear_system`
    foot: Float[Array, "N 4 3 3 batch"]  # D^-1


class Loop(NamedTuple):
    """Where a batch is."""

    state: Splitting
    primal: Float[Array, " batch"]
    dual: Float[Array, " batch"]
    done: Int[Array, " batch"]  # iterations


def invert(constants: MpcConstants, qp: ScaledQp) -> tuple[jax.Array, jax.Array]:
    """`LimitSystem` of one problem."""
    rows = qp.torque.map
    foot = (qp.force_weight + FORCE_PENALTY) * jnp.eye(3) + TORQUE_PENALTY * jnp.swapaxes(rows, -1, -2) @ rows
    factors = factorise(constants, qp, foot, jnp.full(qp.joint.lower.shape, JOINT_PENALTY))
    return inverse(factors), factors.foot


def begin(constants: MpcConstants, qp: ScaledQp, forces: jax.Array, multipliers: jax.Array) -> Splitting:
    """A batch from forces and the multipliers of their cones; the others begin at zero."""
    wrench = qp.wrench(forces)
    torques, joints = qp.torques(forces), qp.joints(constants, wrench)
    t, s = jnp.clip(torques, qp.torque.lower, qp.torque.upper), jnp.clip(joints, qp.joint.lower, qp.joint.upper)
    return Splitting(forces, wrench, torques, joints, forces, multipliers / FORCE_PENALTY, t, 0 * t, s, 0 * s)


def iterate(
    constants: MpcConstants, qp: ScaledQp, system: LimitSystem, projection: ConeProjection, state: Splitting
) -> Splitting:
    """One iteration of a batch."""
    multipliers = Multipliers(
        FORCE_PENALTY * (state.g - state.z + state.u),
        TORQUE_PENALTY * (state.torques - state.t + state.v),
        JOINT_PENALTY * (state.joints - state.s + state.q),
    )
    gradient = lagrangian_gradient(constants, qp, state.g, state.wrench, multipliers)
    g = state.g + newton_step(qp, system.foot, partial(batched_matvec, system.P), gradient)

    wrench = qp.wrench(g)
    torques, joints = qp.torques(g), qp.joints(constants, wrench)
    z_relaxed = relax(g, state.z) + state.u
    z = qp.project(projection, z_relaxed)
    t_relaxed = relax(torques, state.t) + state.v
    t = jnp.clip(t_relaxed, qp.torque.lower, qp.torque.upper)
    s_relaxed = relax(joints, state.s) + state.q
    outside = s_relaxed - jnp.clip(s_relaxed, qp.joint.lower, qp.joint.upper)
    q = jnp.clip(outside, -JOINT_MULTIPLIER_MAX / JOINT_PENALTY, JOINT_MULTIPLIER_MAX / JOINT_PENALTY)
    return Splitting(g, wrench, torques, joints, z, z_relaxed - z, t, t_relaxed - t, s_relaxed - q, q)


def residuals(old: Splitting, new: Splitting, joint_scale: float) -> tuple[jax.Array, jax.Array]:
    """Primal and dual residuals of a batch, positions of joints times `joint_scale`."""
    primal = largest(new.g - new.z, new.torques - new.t, (new.joints - new.s) * joint_scale)
    return primal, largest(new.z - old.z, new.t - old.t, (new.s - old.s) * joint_scale)


def solve_limits(
    constants: MpcConstants,
    qps: ScaledQp,
    projection: ConeProjection,
    start: Iterate,
    iterations: int,
    tolerance: float,
    joint_tolerance: float,
) -> tuple[Iterate, Multipliers, jax.Array]:
    """Iterate on a batch of problems, whose axis is the last one of every array, until all are solved.

    A problem that is solved stays as it is while others go on.

    Args:
        constants: of the controller.
        qps: the problems.
        projection: onto cones.
        start: from the first pass.
        iterations: at most; looked at after every `CHECK_INTERVAL`.
        tolerance: of forces, and of torques in units of force.
        joint_tolerance: of positions [rad].

    Returns:
        The last iterates, the multipliers of cones and limits, and the numbers of iterations (batch,), int32.
    """
    system = LimitSystem(*jax.vmap(invert, (None, -1), (0, -1))(constants, qps))

    def chunk(loop: Loop) -> Loop:
        def step(state: Splitting, _: None) -> tuple[Splitting, None]:
            return iterate(constants, qps, system, projection, state), None

        before, _ = jax.lax.scan(step, loop.state, None, length=CHECK_INTERVAL - 1)
        state = iterate(constants, qps, system, projection, before)
        following = Loop(state, *residuals(before, state, tolerance / joint_tolerance), loop.done + CHECK_INTERVAL)
        return jax.tree.map(partial(jnp.where, unfinished(loop)), following, loop)

    def unfinished(loop: Loop) -> jax.Array:
        residual = jnp.maximum(loop.primal, loop.dual)
        return (loop.done < iterations) & (residual > tolerance)  # a residual that is not a number ends it

    state = begin(constants, qps, start.forces, start.multipliers)
    unknown = jnp.full(start.primal.shape, jnp.inf, start.primal.dtype)
    end = jax.lax.while_loop(
        lambda loop: unfinished(loop).any(), chunk, Loop(state, unknown, unknown, jnp.zeros(unknown.shape, jnp.int32))
    )
    z, u, v, q = end.state.z, end.state.u, end.state.v, end.state.q
    multipliers = Multipliers(FORCE_PENALTY * u, TORQUE_PENALTY * v, JOINT_PENALTY * q)
    return Iterate(z, multipliers.cone, end.primal, end.dual), multipliers, end.done


def relax(new: jax.Array, old: jax.Array) -> jax.Array:
    """The over-relaxed mean of two iterates."""
    return OVER_RELAXATION * new + (1 - OVER_RELAXATION) * old
