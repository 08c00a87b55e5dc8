"""Third pass: the method of multipliers, its subproblems by semismooth Newton steps, for what ADMM leaves.

Problems with many active limits, or with joints that no force can keep within theirs, converge slowly under fixed
penalties. The same splittings and exact penalty as in `limit_admm`, without z, t and s: at prices lambda, the augmented
Lagrangian of g alone is convex and once differentiable, with the gradient of the Lagrangian at the prices

    cone    lambda_g + rho (g - .)   minus its projection, so that x = g + lambda_g / rho gives rho (x - project(x))
    torque  the same with the box of torques and rho_t
    joint   the same with the box of positions and rho_s, cut to +- c

and the generalised Hessian of `limit_system` with D = w 1 + rho (1 - project'(x)) + rho_t A' 1_active A and
W = rho_s 1_active (Li, Sun and Toh 2018, a semismooth Newton augmented Lagrangian method). A step goes to where the
slope along it vanishes; when the gradient is small the prices become those above; and where this leaves most of the
violation the penalties grow.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control.mpc.problem import MpcConstants
from agile_jax.control.mpc.solver.cone_admm import Iterate
from agile_jax.control.mpc.solver.limit_admm import JOINT_PRICE_MAX
from agile_jax.control.mpc.solver.linear_system import (
    BATCHED,
    Factors,
    Prices,
    factorise,
    lagrangian_gradient,
    largest,
    newton_step,
    solve,
)
from agile_jax.control.mpc.solver.scaled_qp import Projection, ScaledQp

PENALTY, TORQUE_PENALTY, JOINT_PENALTY = 6.0, 3.0, 100.0  # rho, rho_t, rho_s [1/rad^2] at the beginning
GROWTH = 3.0  # of the penalties, where an update left more than SLOW of the violation
GROWTH_MAX = 30.0  # above, float32 no longer tells where the steps go
SLOW = 0.6
REGULARISATION = 0.02  # of D: conditions it; the gradient, and so the solution, is without
INNER = 0.1  # the prices change when the gradient is this part of what their change makes
RESOLVED = 10.0  # times the tolerance: no shorter step is told from rounding errors
GRADIENT = 0.3  # times the tolerance: gradient of a solved problem
SLOPES = (0.03, 0.1, 0.2, 0.4, 0.7, 1.0)  # parts of a step at which its slope is looked at


class Point(NamedTuple):
    """Forces and what follows from them, linearly."""

    forces: jax.Array  # (N, 4, 3, batch) g
    wrench: jax.Array  # (N, 6, batch) B g
    torques: jax.Array  # (N, 4, 3, batch) A g
    joints: jax.Array  # (N, 12, batch) K B g


class Newton(NamedTuple):
    """Where a batch is."""

    forces: jax.Array  # (N, 4, 3, batch)
    prices: Prices
    growth: jax.Array  # (batch,) of the penalties
    before: jax.Array  # (batch,) primal residual of the last change of prices
    primal: jax.Array  # (batch,)
    dual: jax.Array  # (batch,)
    steps: jax.Array  # (batch,) int32


def at(constants: MpcConstants, qp: ScaledQp, forces: jax.Array) -> Point:
    """Of given forces."""
    wrench = qp.wrench(forces)
    return Point(forces, wrench, qp.torques(forces), qp.joints(constants, wrench))


def along(point: Point, direction: Point, part: jax.Array) -> Point:
    """A part of a direction further."""
    return jax.tree.map(lambda value, change: value + part * change, point, direction)


def prices_at(qp: ScaledQp, shape: Projection, point: Point, prices: Prices, penalties: Prices) -> Prices:
    """Prices that the method of multipliers would take at a point."""
    cone = point.forces + prices.cone / penalties.cone
    torque = point.torques + prices.torque / penalties.torque
    joint = point.joints + prices.joint / penalties.joint
    outside = penalties.joint * (joint - jnp.clip(joint, qp.joint.lower, qp.joint.upper))
    return Prices(
        penalties.cone * (cone - qp.project(shape, cone)),
        penalties.torque * (torque - jnp.clip(torque, qp.torque.lower, qp.torque.upper)),
        jnp.clip(outside, -JOINT_PRICE_MAX, JOINT_PRICE_MAX),
    )


def projection_derivative(qp: ScaledQp, shape: Projection, forces: jax.Array) -> jax.Array:
    """Generalised Jacobian of the projection onto the cones, shape (N, 4, 3, 3, batch)."""

    def column(axis: int) -> jax.Array:
        unit = jnp.zeros_like(forces).at[:, :, axis].set(1.0)
        return jax.jvp(partial(qp.project, shape), (forces,), (unit,))[1]

    return jnp.stack([column(axis) for axis in range(3)], 3)


def factorise_active(
    constants: MpcConstants, qp: ScaledQp, derivative: jax.Array, active: Prices, penalties: Prices
) -> Factors:
    """The system of one problem, with 1 for active rows of torques and joints and 0 for others."""
    rows = qp.torque.map
    foot = (qp.force_weight + REGULARISATION) * jnp.eye(3) + penalties.cone * (jnp.eye(3) - derivative)
    foot += jnp.swapaxes(rows, -1, -2) @ (rows * (penalties.torque * active.torque)[..., None])
    return factorise(constants, qp, foot, penalties.joint * active.joint)


def solve_newton(
    constants: MpcConstants,
    qps: ScaledQp,
    shape: Projection,
    start: Iterate,
    prices: Prices,
    steps: int,
    tolerance: float,
    joint_tolerance: float,
) -> tuple[Iterate, jax.Array]:
    """Iterate on a batch of problems, whose axis is the last one of every array, until all are solved.

    A problem that is solved stays as it is while others go on.

    Args:
        constants: of the controller.
        qps: the problems.
        shape: projection onto cones.
        start, prices: from the second pass.
        steps: at most.
        tolerance: of forces, and of torques in units of force.
        joint_tolerance: of positions [rad].

    Returns:
        The last iterates, and the numbers of steps (batch,), int32.
    """
    system = jax.vmap(factorise_active, (None, -1, -1, -1, -1), BATCHED)
    solve_systems = jax.vmap(solve, (BATCHED, -1), -1)
    joint_scale = tolerance / joint_tolerance

    def gradient(point: Point, prices: Prices) -> jax.Array:
        return lagrangian_gradient(constants, qps, point.forces, point.wrench, prices)

    def step(now: Newton) -> Newton:
        penalties = Prices(PENALTY * now.growth, TORQUE_PENALTY * now.growth, JOINT_PENALTY * now.growth)
        point = at(constants, qps, now.forces)

        def priced(point: Point) -> Prices:
            return prices_at(qps, shape, point, now.prices, penalties)

        new = priced(point)
        downhill = gradient(point, new)
        active = Prices(
            new.cone, 1.0 * (new.torque != 0), 1.0 * ((new.joint != 0) & (jnp.abs(new.joint) < JOINT_PRICE_MAX))
        )
        derivative = projection_derivative(qps, shape, now.forces + now.prices.cone / penalties.cone)
        factors = system(constants, qps, derivative, active, penalties)
        direction = at(constants, qps, newton_step(qps, factors.foot, partial(solve_systems, factors), downhill))

        def slope(part: jax.Array) -> jax.Array:
            there = along(point, direction, part)
            return (gradient(there, priced(there)) * direction.forces).sum((0, 1, 2))

        part = first_zero((downhill * direction.forces).sum((0, 1, 2)), jax.lax.map(slope, jnp.array(SLOPES)))
        point = along(point, direction, part)
        new = priced(point)
        rest = largest(gradient(point, new))
        length = largest(direction.forces)
        primal = largest(
            (new.cone - now.prices.cone) / penalties.cone,
            (new.torque - now.prices.torque) / penalties.torque,
            (new.joint - now.prices.joint) / penalties.joint * joint_scale,
        )
        dual = jnp.minimum(rest / GRADIENT, length / RESOLVED)
        solved = jnp.maximum(primal, dual) <= tolerance
        # No descent, or hardly a step: the subproblem is solved as far as float32 can tell.
        inner = (rest <= INNER * penalties.cone * primal) | (length <= RESOLVED * tolerance) | (part <= SLOPES[0] / 3)
        slow = inner & (primal > SLOW * now.before)
        return Newton(
            point.forces,
            jax.tree.map(partial(jnp.where, inner | solved), new, now.prices),
            jnp.where(slow, jnp.minimum(GROWTH * now.growth, GROWTH_MAX), now.growth),
            jnp.where(inner, primal, now.before),
            primal,
            dual,
            now.steps + 1,
        )

    def unfinished(now: Newton) -> jax.Array:
        residual = jnp.maximum(now.primal, now.dual)
        return (now.steps < steps) & (residual > tolerance)  # a residual that is not a number ends it

    unknown = jnp.full(start.primal.shape, jnp.inf, start.primal.dtype)
    none = jnp.zeros(unknown.shape, jnp.int32)
    end = jax.lax.while_loop(
        lambda now: unfinished(now).any(),
        lambda now: jax.tree.map(partial(jnp.where, unfinished(now)), step(now), now),
        Newton(start.forces, prices, jnp.ones_like(unknown), unknown, unknown, unknown, none),
    )
    forces = qps.project(shape, end.forces + end.prices.cone / (PENALTY * end.growth))
    return Iterate(forces, end.prices.cone, end.primal, end.dual), end.steps


def first_zero(at_zero: jax.Array, slopes: jax.Array) -> jax.Array:
    """Part of a step where its slope, which grows along it, vanishes; 1 where the slope does not come back.

    Args:
        at_zero: slope at 0, shape (batch,).
        slopes: at `SLOPES`, shape (len(SLOPES), batch).
    """
    parts = jnp.array((0.0, *SLOPES))
    values = jnp.concatenate([at_zero[None], slopes])
    uphill = slopes > 0.1 * jnp.abs(at_zero)
    first = jnp.argmax(uphill, 0)
    below = jnp.minimum(jnp.take_along_axis(values, first[None], 0)[0], 0.0)
    above = jnp.take_along_axis(values, first[None] + 1, 0)[0]
    zero = parts[first] + (parts[first + 1] - parts[first]) * -below / (above - below)
    return jnp.where(uphill.any(0), zero, 1.0)
