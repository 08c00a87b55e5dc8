"""The MPC's quadratic program solved in three passes: friction cones, the joints' limits where they matter, the rest.

A problem that keeps limits it was not told of is solved, since it is the best of a larger set; so all passes answer the
same question. A batch runs its first pass together. The rest is gathered into groups of fixed size, one after the
other, so that a hard problem waits for few others, and an easy one for none. What a problem does in its group does not
depend on who else is there.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

from agile_jax.arrays import AnyArray
from agile_jax.control.mpc.problem import MpcConstants, Qp
from agile_jax.control.mpc.solver.cone_admm import Iterate, solve_cones
from agile_jax.control.mpc.solver.limit_admm import solve_limits
from agile_jax.control.mpc.solver.linear_system import Multipliers
from agile_jax.control.mpc.solver.newton import MethodOfMultipliers, solve_newton
from agile_jax.control.mpc.solver.projection import PROJECTIONS, ConeProjection, shrink_into
from agile_jax.control.mpc.solver.scaled_qp import FORCE_UNIT, ScaledQp, scale
from agile_jax.control.settings import MpcSettings

SOLVED, INFEASIBLE, UNCONVERGED, NOT_FINITE = 0, 1, 2, 3
JOINT_TOLERANCE = 1e-3  # by which a solved problem may break a row of joint positions [rad]
JOINT_RESIDUAL = 1e-4  # at which these rows count as converged [rad]; with 1e-3 a force is up to 0.15 N off
BLOCK = 64  # problems that a CPU solves at once
GROUPS = 4, 16  # a group of the second and of the third pass holds this part of a batch
SMALLEST_GROUP = 16, 4


class WarmStart(NamedTuple):
    """Iterates of the solver for one problem of N nodes, scaled."""

    forces: Float[Array, "N 4 3"]
    multipliers: Float[Array, "N 4 3"]  # of the cones


class QpSolution(NamedTuple):
    """Forces that every foot can have, how far from optimal they are, and what to say about them.

    The forces are inside their cones and their joints' torque limits whatever the status, except NOT_FINITE, which
    has zeros. INFEASIBLE: no forces keep the joints' positions; these break them least. UNCONVERGED: not yet optimal.
    """

    forces: Float[Array, "N 12"]  # [N]
    status: Int[Array, ""]  # SOLVED, INFEASIBLE, UNCONVERGED or NOT_FINITE
    primal_residual: Float[Array, ""]  # largest violation of a splitting [N]
    dual_residual: Float[Array, ""]  # largest change in an iteration [N]
    joint_violation: Float[Array, ""]  # largest of the rows of joint positions [rad]
    iterations: Int[Array, ""]  # of the second pass, plus steps of the third
    warm_start: WarmStart


class Found(NamedTuple):
    """What the passes so far have found for a batch of problems, scaled."""

    iterate: Iterate
    multipliers: Multipliers
    iterations: Int[Array, " batch"]  # of the second pass, plus steps of the third


Solver = Callable[[Qp, WarmStart], QpSolution]


def cold_start(nodes: int) -> WarmStart:
    """Zero iterates."""
    return WarmStart(jnp.zeros((nodes, 4, 3)), jnp.zeros((nodes, 4, 3)))


def shift(start: WarmStart, nodes: float) -> WarmStart:
    """Iterates of a horizon that begins later by a part of a node or by more; the last node is kept."""
    count = len(start.forces)
    where = jnp.minimum(jnp.arange(count) + nodes, count - 1)
    before = jnp.floor(where).astype(int)
    weight = (where - before)[:, None, None]

    def move(values: jax.Array) -> jax.Array:
        return (1 - weight) * values[before] + weight * values[jnp.minimum(before + 1, count - 1)]

    return WarmStart(move(start.forces), move(start.multipliers))


@dataclasses.dataclass(frozen=True, eq=False)
class Passes:
    """The three passes on a batch of problems, whose axis is the last one of every array."""

    constants: MpcConstants
    settings: MpcSettings

    @property
    def tolerance(self) -> float:
        """Largest residual of a solved problem, scaled."""
        return self.settings.tolerance / FORCE_UNIT

    @property
    def projection(self) -> ConeProjection:
        """Onto the cone, or the pyramid, of friction."""
        return PROJECTIONS[self.settings.friction_cone]

    def solve(self, qps: ScaledQp, start: WarmStart) -> tuple[Iterate, jax.Array]:
        """The iterates after all passes, and the iterations (batch,) after the first pass."""
        iterate = solve_cones(self.constants, qps, self.projection, *start, self.settings.iterations, self.tolerance)
        none = Multipliers(0 * iterate.multipliers, 0 * iterate.multipliers, jnp.zeros_like(qps.joint.lower))
        found = Found(iterate, none, jnp.zeros(iterate.primal.shape, jnp.int32))
        found = in_groups(self.second, 0, qps, found, jax.vmap(self.left_to_do, -1)(qps, iterate))
        residual = jnp.maximum(found.iterate.primal, found.iterate.dual)
        found = in_groups(self.third, 1, qps, found, jnp.where(residual > self.tolerance, residual, 0.0))
        return found.iterate, found.iterations

    def left_to_do(self, qp: ScaledQp, found: Iterate) -> jax.Array:
        """How far one problem is from solved after the first pass, 0 where it is."""
        over = violation(qp.torques(found.forces), qp.torque.lower, qp.torque.upper)
        residual = jnp.maximum(jnp.maximum(found.primal, found.dual), over)
        broken = joint_violation(self.constants, qp, found.forces)
        solved = (residual <= self.tolerance) & (broken <= JOINT_RESIDUAL)
        return jnp.where(solved, 0.0, jnp.maximum(residual, broken))

    def second(self, qps: ScaledQp, found: Found) -> Found:
        """Go on with a group that the first pass has not solved."""
        iterations, tolerance = self.settings.iterations_limits, self.tolerance
        limits = solve_limits(
            self.constants, qps, self.projection, found.iterate, iterations, tolerance, JOINT_RESIDUAL
        )
        return Found(*limits)

    def third(self, qps: ScaledQp, found: Found) -> Found:
        """Go on with a group that the second pass has not solved."""
        steps, tolerance = self.settings.newton_steps, self.tolerance
        method = MethodOfMultipliers(self.constants, qps, self.projection, steps, tolerance, JOINT_RESIDUAL)
        iterate, steps_made = solve_newton(method, found.iterate, found.multipliers)
        return Found(iterate, found.multipliers, found.iterations + steps_made)


def make_solver(constants: MpcConstants, settings: MpcSettings) -> Solver:
    """The solver of one problem, from a warm start; vmap it."""
    passes = Passes(constants, settings)

    @jax.custom_batching.custom_vmap
    def solve_one(qp: ScaledQp, start: WarmStart) -> tuple[Iterate, jax.Array]:
        batch = jax.tree.map(lambda values: values[..., None], (qp, start))
        return jax.tree.map(lambda values: values[..., 0], passes.solve(*batch))

    @solve_one.def_vmap
    def solve_many(size: int, batched: PyTree, qps: ScaledQp, start: WarmStart) -> tuple[PyTree, PyTree]:
        def last(values: AnyArray, has_batch: bool) -> jax.Array:
            if has_batch:
                return jnp.moveaxis(values, 0, -1)
            return jnp.broadcast_to(values[..., None], (*values.shape, size))

        batch = jax.tree.map(last, (qps, start), tuple(batched))
        end = jax.lax.platform_dependent(*batch, cpu=partial(in_blocks, passes.solve), default=passes.solve)
        return jax.tree.map(lambda values: jnp.moveaxis(values, -1, 0), end), jax.tree.map(lambda _: True, end)

    def solve(qp: Qp, start: WarmStart) -> QpSolution:
        scaled = scale(qp)
        return solution_of(constants, scaled, passes.tolerance, *solve_one(scaled, start))

    return solve


def solution_of(
    constants: MpcConstants, qp: ScaledQp, tolerance: float, found: Iterate, iterations: jax.Array
) -> QpSolution:
    """The iterate of one problem in SI units, its forces inside their limits, and its status."""
    finite = jnp.isfinite(found.forces).all() & jnp.isfinite(found.multipliers).all()
    forces = shrink_into(found.forces, qp.torques(found.forces), qp.torque.lower, qp.torque.upper)
    broken = joint_violation(constants, qp, forces)
    converged = jnp.maximum(found.primal, found.dual) <= tolerance
    status = jnp.where(converged, jnp.where(broken <= JOINT_TOLERANCE, SOLVED, INFEASIBLE), UNCONVERGED)
    return QpSolution(
        jnp.where(finite, forces, 0.0).reshape(-1, 12) * FORCE_UNIT,
        jnp.where(finite, status, NOT_FINITE).astype(jnp.int32),
        found.primal * FORCE_UNIT,
        found.dual * FORCE_UNIT,
        broken,
        iterations,
        WarmStart(jnp.where(finite, found.forces, 0.0), jnp.where(finite, found.multipliers, 0.0)),
    )


def in_groups(
    solve: Callable[[ScaledQp, Found], Found], which: int, qps: ScaledQp, found: Found, left: jax.Array
) -> Found:
    """Go on with those problems of a batch that have something left, alike ones together: each waits for the slowest.

    Args:
        solve: goes on with a group.
        which: 0 for the second pass, 1 for the third.
        qps, found: the batch.
        left: how far each is from solved, 0 where it is, shape (batch,).
    """
    size = len(left)
    group = min(size, max(SMALLEST_GROUP[which], size // GROUPS[which]))

    def one_group(carry: tuple[Found, jax.Array]) -> tuple[Found, jax.Array]:
        found, pending = carry
        # Solved problems that fill a group stay as they are.
        index = jnp.argsort(jnp.where(pending, -left, jnp.inf))[:group]
        members, begun = jax.tree.map(lambda values: values[..., index], (qps, found))

        def put(values: jax.Array, new: jax.Array) -> jax.Array:
            return values.at[..., index].set(jnp.where(pending[index], new, values[..., index]))

        return jax.tree.map(put, found, solve(members, begun)), pending.at[index].set(False)

    return jax.lax.while_loop(lambda carry: carry[1].any(), one_group, (found, (left > 0) & jnp.isfinite(left)))[0]


def in_blocks(solve: Callable[..., PyTree], *batch: PyTree) -> PyTree:
    """Solve `BLOCK` problems after another, which stay in the cache of a core; a larger batch waits for memory."""
    size = jax.tree.leaves(batch)[0].shape[-1]
    whole = size - size % BLOCK
    parts = [solve(*jax.tree.map(lambda values: values[..., whole:], batch))] if whole < size else []
    if whole:
        blocks = jax.tree.map(
            lambda values: jnp.moveaxis(values[..., :whole].reshape(*values.shape[:-1], -1, BLOCK), -2, 0), batch
        )
        ends = jax.lax.map(lambda block: solve(*block), blocks)
        parts.insert(0, jax.tree.map(lambda end: jnp.moveaxis(end, 0, -2).reshape(*end.shape[1:-1], whole), ends))
    return jax.tree.map(lambda *ends: jnp.concatenate(ends, -1), *parts)


def violation(values: jax.Array, lower: jax.Array, upper: jax.Array) -> jax.Array:
    """By how much the worst of the values is out of its bounds, or 0."""
    return jnp.maximum(jnp.maximum(lower - values, values - upper).max(), 0.0)


def joint_violation(constants: MpcConstants, qp: ScaledQp, forces: jax.Array) -> jax.Array:
    """By how much forces (N, 4, 3) break the worst row of joint positions of one problem [rad]."""
    return violation(qp.joints(constants, qp.wrench(forces)), qp.joint.lower, qp.joint.upper)
