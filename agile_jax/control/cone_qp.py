"""The MPC's quadratic program solved in two passes: friction cones first, the joints' limits where they matter.

Most problems of a walk touch no limit of a joint, and 30 cheap iterations solve them (`force_admm`). Whatever then is
not converged, or breaks a limit, goes on in the general method (`limit_admm`) until it is. A problem that keeps limits
it was not told of is solved, since it is the best of a larger set; so both passes answer the same question.

A batch runs its first pass together. The rest is gathered into groups of fixed size, one after the other, so that a
hard problem waits for few others, and an easy one for none. What a problem does in its group does not depend on who
else is there.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control.force_admm import Iterate, solve_cones
from agile_jax.control.limit_admm import solve_limits
from agile_jax.control.mpc import Qp
from agile_jax.control.projection import PROJECTIONS, shrink_into
from agile_jax.control.scaled_qp import FORCE_UNIT, Projection, ScaledQp, scale
from agile_jax.control.settings import MpcSettings

SOLVED, INFEASIBLE, UNCONVERGED, NOT_FINITE = 0, 1, 2, 3
STATUS_NAMES = ("solved", "infeasible", "unconverged", "not finite")
JOINT_TOLERANCE = 1e-3  # of the rows of joint positions [rad]
GROUPS = 8  # a group of the second pass holds this part of a batch
SMALLEST_GROUP = 8


class WarmStart(NamedTuple):
    """Iterates of the solver, scaled."""

    forces: jax.Array  # (N, 4, 3)
    price: jax.Array  # (N, 4, 3) of the cones


class QpSolution(NamedTuple):
    """Forces that every foot can have, how far from optimal they are, and what to say about them.

    The forces are inside their cones and their joints' torque limits whatever the status, except NOT_FINITE, which
    has zeros. INFEASIBLE: no forces keep the joints' positions; these break them least. UNCONVERGED: not yet optimal.
    """

    forces: jax.Array  # (N, 12) [N]
    status: jax.Array  # () int32, SOLVED, INFEASIBLE, UNCONVERGED or NOT_FINITE
    primal_residual: jax.Array  # () largest violation of a splitting [N]
    dual_residual: jax.Array  # () largest change in an iteration [N]
    joint_violation: jax.Array  # () largest of the rows of joint positions [rad]
    iterations: jax.Array  # () int32, of the second pass
    warm_start: WarmStart


class Pass(NamedTuple):
    """Where a problem stands."""

    iterate: Iterate
    iterations: jax.Array  # () int32, of the second pass


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

    return WarmStart(move(start.forces), move(start.price))


def make_solver(settings: MpcSettings) -> Solver:
    """The solver of one problem; vmap it."""
    tolerance = settings.tolerance / FORCE_UNIT
    shape = PROJECTIONS[settings.friction_cone]

    def projection(qp: ScaledQp) -> Projection:
        return lambda forces: shape(forces, qp.friction, qp.force_max) * qp.contact[..., None]

    def first(qp: Qp, start: WarmStart) -> tuple[Pass, jax.Array]:
        """All problems, and whether each needs the second pass."""
        scaled = scale(qp)
        found = solve_cones(scaled, projection(scaled), *start, settings.iterations)
        torque = violation(scaled.torques(found.forces), scaled.torque.lower, scaled.torque.upper)
        done = jnp.maximum(jnp.maximum(found.primal, found.dual), torque) <= tolerance
        done &= joint_violation(scaled, found.forces) <= JOINT_TOLERANCE
        return Pass(found, jnp.int32(0)), ~done

    def second(qp: Qp, begun: Pass) -> Pass:
        scaled = scale(qp)
        return Pass(
            *solve_limits(
                scaled, projection(scaled), begun.iterate, settings.iterations_max, tolerance, JOINT_TOLERANCE
            )
        )

    def conclude(qp: Qp, end: Pass) -> QpSolution:
        scaled = scale(qp)
        found = end.iterate
        finite = jnp.isfinite(found.forces).all() & jnp.isfinite(found.price).all()
        forces = shrink_into(found.forces, scaled.torques(found.forces), scaled.torque.lower, scaled.torque.upper)
        broken = joint_violation(scaled, forces)
        converged = jnp.maximum(found.primal, found.dual) <= tolerance
        status = jnp.where(converged, jnp.where(broken <= 2 * JOINT_TOLERANCE, SOLVED, INFEASIBLE), UNCONVERGED)
        return QpSolution(
            jnp.where(finite, forces, 0.0).reshape(-1, 12) * FORCE_UNIT,
            jnp.where(finite, status, NOT_FINITE).astype(jnp.int32),
            found.primal * FORCE_UNIT,
            found.dual * FORCE_UNIT,
            broken,
            end.iterations,
            WarmStart(jnp.where(finite, found.forces, 0.0), jnp.where(finite, found.price, 0.0)),
        )

    @jax.custom_batching.custom_vmap
    def both(qp: Qp, start: WarmStart) -> Pass:
        begun, hard = first(qp, start)
        return jax.lax.cond(hard, second, lambda _, begun: begun, qp, begun)

    @both.def_vmap
    def both_batched(size: int, batched: Any, qp: Qp, start: WarmStart) -> tuple[Pass, Any]:
        axes = jax.tree.map(lambda has: 0 if has else None, batched)
        begun, hard = jax.vmap(first, in_axes=tuple(axes))(qp, start)
        group = min(size, max(SMALLEST_GROUP, size // GROUPS))

        def one_group(carry: tuple[Pass, jax.Array]) -> tuple[Pass, jax.Array]:
            passes, pending = carry
            index = jnp.argsort(~pending)[:group]  # those that wait come first; others fill the group and stay
            waits = pending[index]
            some_qp = jax.tree.map(lambda has, values: values[index] if has else values, batched[0], qp)
            old = jax.tree.map(lambda values: values[index], passes)
            new = jax.vmap(second, in_axes=(axes[0], 0))(some_qp, old)

            def put(values: jax.Array, before: jax.Array, after: jax.Array) -> jax.Array:
                chosen = waits.reshape(-1, *[1] * (values.ndim - 1))
                return values.at[index].set(jnp.where(chosen, after, before))

            return jax.tree.map(put, passes, old, new), pending.at[index].set(False)

        passes, _ = jax.lax.while_loop(lambda carry: carry[1].any(), one_group, (begun, hard))
        return passes, jax.tree.map(lambda _: True, passes)

    def solve(qp: Qp, start: WarmStart) -> QpSolution:
        return conclude(qp, both(qp, start))

    return solve


def violation(values: jax.Array, lower: jax.Array, upper: jax.Array) -> jax.Array:
    """By how much the worst of the values is out of its bounds, or 0."""
    return jnp.maximum(jnp.maximum(lower - values, values - upper).max(), 0.0)


def joint_violation(qp: ScaledQp, forces: jax.Array) -> jax.Array:
    """Of the rows of joint positions [rad]."""
    return violation(qp.joints(qp.wrench(forces)), qp.joint.lower, qp.joint.upper)
