"""Third pass: the method of multipliers, its subproblems by semismooth Newton steps, for what ADMM leaves.

Problems with many active limits, or with joints that no force can keep within theirs, converge slowly under fixed
penalties. The same splittings and exact penalty as in `limit_admm`, without z, t and s: at multipliers lambda, the
augmented Lagrangian of g alone is convex and once differentiable. Its gradient is that of the Lagrangian at the
multipliers

    cone    lambda_g + rho (g - .)   minus its projection, so that x = g + lambda_g / rho gives rho (x - project(x))
    torque  the same with the box of torques and rho_t
    joint   the same with the box of positions and rho_s, cut to +- c

and the generalised Hessian of `linear_system` with D = w 1 + rho (1 - project'(x)) + rho_t A' 1_active A and
W = rho_s 1_active (Li, Sun and Toh 2018, a semismooth Newton augmented Lagrangian method). A step goes to where the
slope along it vanishes; when the gradient is small the multipliers become those above; and where this leaves most of
the violation the penalties grow.
"""

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from agile_jax.control.mpc.problem import MpcConstants
from agile_jax.control.mpc.solver.cone_admm import Iterate
from agile_jax.control.mpc.solver.limit_admm import JOINT_MULTIPLIER_MAX
from agile_jax.control.mpc.solver.linear_system import (
    BATCHED,
    Factors,
    Multipliers,
    factorise,
    lagrangian_gradient,
    largest,
    newton_step,
    solve,
)
from agile_jax.control.mpc.solver.projection import ConeProjection
from agile_jax.control.mpc.solver.scaled_qp import ScaledQp

FORCE_PENALTY, TORQUE_PENALTY, JOINT_PENALTY = 6.0, 3.0, 100.0  # rho, rho_t, rho_s [1/rad^2] at the beginning
PENALTY_GROWTH = 3.0  # where a change of the multipliers left more than SLOW_DECREASE of the violation
PENALTY_GROWTH_MAX = 30.0  # in all; above, float32 no longer tells where the steps go
SLOW_DECREASE = 0.6
REGULARISATION = 0.02  # of D: conditions it; the gradient, and so the solution, is without
SUBPROBLEM_TOLERANCE = 0.1  # the multipliers change when the gradient is this part of what their change makes
SHORTEST_STEP = 10.0  # times the tolerance: no shorter step is told from rounding errors
GRADIENT_TOLERANCE = 0.3  # times the tolerance: gradient of a solved problem
LINE_SEARCH = (0.03, 0.1, 0.2, 0.4, 0.7, 1.0)  # parts of a step at which its slope is looked at


class Point(NamedTuple):
    """Forces and what follows from them, linearly."""

    forces: Float[Array, "N 4 3 batch"]  # g
    wrench: Float[Array, "N 6 batch"]  # B g
    torques: Float[Array, "N 4 3 batch"]  # A g
    joints: Float[Array, "N 12 batch"]  # K B g


class State(NamedTuple):
    """Where a batch is."""

    forces: Float[Array, "N 4 3 batch"]
    multipliers: Multipliers
    growth: Float[Array, " batch"]  # of the penalties
    before: Float[Array, " batch"]  # primal residual of the last change of multipliers
    primal: Float[Array, " batch"]
    dual: Float[Array, " batch"]
    steps: Int[Array, " batch"]


def point_at(constants: MpcConstants, qp: ScaledQp, forces: jax.Array) -> Point:
    """The point of given forces (N, 4, 3, batch)."""
    wrench = qp.wrench(forces)
    return Point(forces, wrench, qp.torques(forces), qp.joints(constants, wrench))


def moved(point: Point, direction: Point, part: jax.Array) -> Point:
    """The point that is a part of a step further."""
    return jax.tree.map(lambda value, change: value + part * change, point, direction)


def multipliers_at(
    qp: ScaledQp, projection: ConeProjection, point: Point, multipliers: Multipliers, penalties: Multipliers
) -> Multipliers:
    """Multipliers that the method of multipliers would take at a point."""
    cone = point.forces + multipliers.cone / penalties.cone
    torque = point.torques + multipliers.torque / penalties.torque
    joint = point.joints + multipliers.joint / penalties.joint
    outside = penalties.joint * (joint - jnp.clip(joint, qp.joint.lower, qp.joint.upper))
    return Multipliers(
        penalties.cone * (cone - qp.project(projection, cone)),
        penalties.torque * (torque - jnp.clip(torque, qp.torque.lower, qp.torque.upper)),
        jnp.clip(outside, -JOINT_MULTIPLIER_MAX, JOINT_MULTIPLIER_MAX),
    )


def projection_derivative(qp: ScaledQp, projection: ConeProjection, forces: jax.Array) -> jax.Array:
    """Generalised Jacobian of the projection onto the cones, shape (N, 4, 3, 3, batch)."""

    def column(axis: int) -> jax.Array:
        unit = jnp.zeros_like(forces).at[:, :, axis].set(1.0)
        return jax.jvp(partial(qp.project, projection), (forces,), (unit,))[1]

    return jnp.stack([column(axis) for axis in range(3)], 3)


def factorise_active(
    constants: MpcConstants, qp: ScaledQp, derivative: jax.Array, active: Multipliers, penalties: Multipliers
) -> Factors:
    """The system of one problem, with 1 for active rows of torques and joints and 0 for others."""
    rows = qp.torque.map
    foot = (qp.force_weight + REGULARISATION) * jnp.eye(3) + penalties.cone * (jnp.eye(3) - derivative)
    foot += jnp.swapaxes(rows, -1, -2) @ (rows * (penalties.torque * active.torque)[..., None])
    return factorise(constants, qp, foot, penalties.joint * active.joint)


@dataclasses.dataclass(frozen=True, eq=False)
class MethodOfMultipliers:
    """The iteration on one batch of problems."""

    constants: MpcConstants
    qps: ScaledQp
    projection: ConeProjection
    steps: int  # at most
    tolerance: float  # of forces, and of torques in units of force
    joint_tolerance: float  # of positions [rad]

    def gradient(self, point: Point, multipliers: Multipliers) -> jax.Array:
        """Gradient of the augmented Lagrangian, whose multipliers at the point are given. Shape (N, 4, 3, batch)."""
        return lagrangian_gradient(self.constants, self.qps, point.forces, point.wrench, multipliers)

    def unfinished(self, now: State) -> jax.Array:
        """Which problems go on, shape (batch,) bool."""
        residual = jnp.maximum(now.primal, now.dual)
        return (now.steps < self.steps) & (residual > self.tolerance)  # a residual that is not a number ends it

    def step(self, now: State) -> State:
        """One Newton step of the forces, and a change of the multipliers where it solves the subproblem."""
        penalties = Multipliers(*(start * now.growth for start in (FORCE_PENALTY, TORQUE_PENALTY, JOINT_PENALTY)))
        point, part, direction = self.newton_step(now, penalties)
        new = multipliers_at(self.qps, self.projection, point, now.multipliers, penalties)
        rest = largest(self.gradient(point, new))
        length = largest(direction.forces)
        primal = largest(
            (new.cone - now.multipliers.cone) / penalties.cone,
            (new.torque - now.multipliers.torque) / penalties.torque,
            (new.joint - now.multipliers.joint) / penalties.joint * (self.tolerance / self.joint_tolerance),
        )
        dual = jnp.minimum(rest / GRADIENT_TOLERANCE, length / SHORTEST_STEP)
        solved = jnp.maximum(primal, dual) <= self.tolerance
        # No descent, or hardly a step: the subproblem is solved as far as float32 can tell.
        inner = rest <= SUBPROBLEM_TOLERANCE * penalties.cone * primal
        inner |= (length <= SHORTEST_STEP * self.tolerance) | (part <= LINE_SEARCH[0] / 3)
        slow = inner & (primal > SLOW_DECREASE * now.before)
        return State(
            point.forces,
            jax.tree.map(partial(jnp.where, inner | solved), new, now.multipliers),
            jnp.where(slow, jnp.minimum(PENALTY_GROWTH * now.growth, PENALTY_GROWTH_MAX), now.growth),
            jnp.where(inner, primal, now.before),
            primal,
            dual,
            now.steps + 1,
        )

    def newton_step(self, now: State, penalties: Multipliers) -> tuple[Point, jax.Array, Point]:
        """Where a step ends, which part of it was taken (batch,), and the whole step."""
        constants, qps = self.constants, self.qps
        point = point_at(constants, qps, now.forces)

        def multipliers(point: Point) -> Multipliers:
            return multipliers_at(qps, self.projection, point, now.multipliers, penalties)

        new = multipliers(point)
        downhill = self.gradient(point, new)
        hard = (new.joint != 0) & (jnp.abs(new.joint) < JOINT_MULTIPLIER_MAX)
        active = Multipliers(new.cone, 1.0 * (new.torque != 0), 1.0 * hard)
        derivative = projection_derivative(qps, self.projection, now.forces + now.multipliers.cone / penalties.cone)
        factors = jax.vmap(factorise_active, (None, -1, -1, -1, -1), BATCHED)(
            constants, qps, derivative, active, penalties
        )
        apply_P = partial(jax.vmap(solve, (BATCHED, -1), -1), factors)
        direction = point_at(constants, qps, newton_step(qps, factors.foot, apply_P, downhill))

        def slope(part: jax.Array) -> jax.Array:
            there = moved(point, direction, part)
            return (self.gradient(there, multipliers(there)) * direction.forces).sum((0, 1, 2))

        slopes = jax.lax.map(slope, jnp.array(LINE_SEARCH))
        part = first_zero((downhill * direction.forces).sum((0, 1, 2)), slopes)
        return moved(point, direction, part), part, direction


def solve_newton(method: MethodOfMultipliers, start: Iterate, multipliers: Multipliers) -> tuple[Iterate, jax.Array]:
    """Iterate on a batch of problems, whose axis is the last one of every array, until all are solved.

    A problem that is solved stays as it is while others go on.

    Args:
        method: with the problems.
        start, multipliers: from the second pass.

    Returns:
        The last iterates, and the numbers of steps (batch,), int32.
    """
    unknown = jnp.full(start.primal.shape, jnp.inf, start.primal.dtype)
    none = jnp.zeros(unknown.shape, jnp.int32)
    end = jax.lax.while_loop(
        lambda now: method.unfinished(now).any(),
        lambda now: jax.tree.map(partial(jnp.where, method.unfinished(now)), method.step(now), now),
        State(start.forces, multipliers, jnp.ones_like(unknown), unknown, unknown, unknown, none),
    )
    at = end.forces + end.multipliers.cone / (FORCE_PENALTY * end.growth)
    forces = method.qps.project(method.projection, at)
    return Iterate(forces, end.multipliers.cone, end.primal, end.dual), end.steps


def first_zero(at_zero: jax.Array, slopes: jax.Array) -> jax.Array:
    """Part of a step where its slope, which grows along it, vanishes; 1 where the slope does not come back.

    Args:
        at_zero: slope at 0, shape (batch,).
        slopes: at `LINE_SEARCH`, shape (len(LINE_SEARCH), batch).
    """
    parts = jnp.array((0.0, *LINE_SEARCH))
    values = jnp.concatenate([at_zero[None], slopes])
    uphill = slopes > 0.1 * jnp.abs(at_zero)
    first = jnp.argmax(uphill, 0)
    below = jnp.minimum(jnp.take_along_axis(values, first[None], 0)[0], 0.0)
    above = jnp.take_along_axis(values, first[None] + 1, 0)[0]
    zero = parts[first] + (parts[first + 1] - parts[first]) * -below / (above - below)
    return jnp.where(uphill.any(0), zero, 1.0)
