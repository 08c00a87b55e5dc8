"""What the controller says about itself: the last solution of its MPC, saturated torques, and broken constraints."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from agile_jax.control.mpc.solver.cascade import INFEASIBLE, NOT_FINITE, SOLVED, UNCONVERGED, QpSolution
from agile_jax.robot import RobotModel

CONSTRAINT_TOLERANCE = 1e-3  # by which a force [N], a torque [Nm] or a joint [rad] may pass its limit


class Counts(NamedTuple):
    """How often since the start, each () int32; a value that is not a number counts as broken."""

    mpc_failures: Int[Array, ""]  # plans whose problem was not solved, for one of the next three reasons
    mpc_infeasible: Int[Array, ""]  # plans in which no forces kept the joints' positions: those that break them least
    mpc_unconverged: Int[Array, ""]  # plans in which the iterations ran out: the last iterate, inside cones and torques
    mpc_not_finite: Int[Array, ""]  # plans without a solution: the forces of the plan before
    cone_violations: Int[Array, ""]  # plans with a commanded force outside its friction cone or its bounds
    torque_violations: Int[Array, ""]  # commands with a torque over its limit
    joint_violations: Int[Array, ""]  # commands at which a measured joint was past its limit
    stance_saturations: Int[Array, ""]  # commands in which a standing leg's planned torque was cut to its limit


class Diagnostics(NamedTuple):
    """The last plan and the last command of one robot, and the counts."""

    status: Int[Array, ""]  # SOLVED, INFEASIBLE, UNCONVERGED or NOT_FINITE of `mpc.solver`
    primal_residual: Float[Array, ""]  # [N]
    dual_residual: Float[Array, ""]  # [N]
    cone_violation: Float[Array, ""]  # |f_xy| - mu f_z of the commanded forces, the largest of the feet [N]
    joint_violation: Float[Array, ""]  # predicted, of the rows of joint positions [rad]
    iterations: Int[Array, ""]  # of the solver's second pass, plus steps of its third
    saturated: Bool[Array, "12"]  # torques cut to their limit
    counts: Counts


def no_diagnostics() -> Diagnostics:
    """Before the first plan."""
    zero = jnp.float32(0.0)
    return Diagnostics(
        jnp.int32(SOLVED),
        zero,
        zero,
        zero,
        zero,
        jnp.int32(0),
        jnp.zeros(12, bool),
        Counts(*(jnp.int32(0) for _ in Counts._fields)),
    )


def after_plan(
    diagnostics: Diagnostics, solution: QpSolution, forces: jax.Array, friction: jax.Array, force_max: jax.Array
) -> Diagnostics:
    """Record a solution and judge the forces (4, 3) [N] that are commanded."""
    counts = diagnostics.counts
    tangential = jnp.sqrt(jnp.sum(forces[:, :2] ** 2, -1))
    over = tangential - friction * forces[:, 2]
    inside = (tangential <= friction * forces[:, 2] + CONSTRAINT_TOLERANCE) & (
        forces[:, 2] <= force_max + CONSTRAINT_TOLERANCE
    )
    return diagnostics._replace(
        status=solution.status,
        primal_residual=solution.primal_residual,
        dual_residual=solution.dual_residual,
        cone_violation=over.max(),
        joint_violation=solution.joint_violation,
        iterations=solution.iterations,
        counts=counts._replace(
            mpc_failures=counts.mpc_failures + (solution.status != SOLVED),
            mpc_infeasible=counts.mpc_infeasible + (solution.status == INFEASIBLE),
            mpc_unconverged=counts.mpc_unconverged + (solution.status == UNCONVERGED),
            mpc_not_finite=counts.mpc_not_finite + (solution.status == NOT_FINITE),
            cone_violations=counts.cone_violations + ~inside.all(),
        ),
    )


def after_act(
    diagnostics: Diagnostics,
    robot: RobotModel,
    joint_pos: jax.Array,
    wanted: jax.Array,
    torque: jax.Array,
    standing: jax.Array,
) -> Diagnostics:
    """Judge a command.

    Args:
        diagnostics: so far.
        robot: for its limits.
        joint_pos: measured, shape (12,) [rad].
        wanted, torque: before and after the cut to the limits, shape (12,) [Nm].
        standing: (4,) bool.
    """
    counts = diagnostics.counts
    saturated = jnp.abs(wanted) > robot.torque_limit
    inside = (joint_pos >= robot.joint_lower - CONSTRAINT_TOLERANCE) & (
        joint_pos <= robot.joint_upper + CONSTRAINT_TOLERANCE
    )
    within = jnp.abs(torque) <= robot.torque_limit + CONSTRAINT_TOLERANCE
    return diagnostics._replace(
        saturated=saturated,
        counts=counts._replace(
            torque_violations=counts.torque_violations + ~within.all(),
            joint_violations=counts.joint_violations + ~inside.all(),
            stance_saturations=counts.stance_saturations + (saturated & jnp.repeat(standing, 3)).any(),
        ),
    )
