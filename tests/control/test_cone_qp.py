"""The solver: known solutions, independent solvers, every constraint active, and what it says when it fails."""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.benchmark.peers.dense_qp import dense_qp, violations
from agile_jax.benchmark.peers.qp_solvers import make_clarabel, make_piqp
from agile_jax.control import MpcSettings
from agile_jax.control.mpc.centroidal import force_map
from agile_jax.control.mpc.leg_limits import JointRows, TorqueRows
from agile_jax.control.mpc.problem import Qp, mpc_constants
from agile_jax.control.mpc.solver.cascade import (
    INFEASIBLE,
    NOT_FINITE,
    SOLVED,
    UNCONVERGED,
    QpSolution,
    WarmStart,
    cold_start,
    in_blocks,
    make_solver,
    shift,
)
from agile_jax.control.mpc.solver.projection import project_cone

SETTINGS = MpcSettings()
CONSTANTS = mpc_constants(SETTINGS)
NODES = SETTINGS.horizon
ACCURATE = 0.1  # [N]


@lru_cache
def compiled(cone: str = "cone", iterations_limits: int = SETTINGS.iterations_limits, **changes: float) -> Any:
    changed = {"friction_cone": cone, "iterations_limits": iterations_limits, **changes}
    settings = SETTINGS.model_copy(update=changed)
    solve = make_solver(CONSTANTS, settings)
    return jax.jit(jax.vmap(lambda qp: solve(qp, cold_start(NODES))))


def solve_exactly(qp: Qp, pyramid: bool) -> list[np.ndarray]:
    """All forces, by Clarabel (cone) or PIQP (pyramid), in float64; not a number where the problem is infeasible."""
    pytest.importorskip("piqp" if pyramid else "clarabel")
    peer = make_piqp() if pyramid else make_clarabel(1e-9)
    found = []
    for i in range(len(qp.linear)):
        problem = dense_qp(CONSTANTS, qp, i)
        x = peer.prepare(problem)()
        forces = np.zeros(12 * NODES)  # those of feet in the air stay zero
        forces[problem.columns] = np.nan if x is None else x
        found.append(forces)
    return found


def agree(solution: QpSolution, expected: list[np.ndarray]) -> None:
    forces = np.array(solution.forces, float)[:, 0]
    np.testing.assert_allclose(forces, np.array(expected)[:, :12], atol=ACCURATE)
    np.testing.assert_array_equal(solution.status, SOLVED)


def check_constraints(qp: Qp, solution: QpSolution, pyramid: bool = False) -> None:
    for i, forces in enumerate(np.array(solution.forces, float)):
        problem = dense_qp(CONSTANTS, qp, i)
        broken = violations(problem, forces.reshape(-1)[problem.columns], pyramid)
        assert broken.cone < 1e-4
        assert broken.torque < 1e-4
        np.testing.assert_array_equal(forces.reshape(-1)[~problem.columns], 0.0)


def backward_problem(seed: int) -> tuple[Qp, np.ndarray]:
    """A problem whose solution is known: multipliers first, then the forces, then the bounds and the linear cost.

    The forces minimise w/2 |f|^2 + (B' lambda + A' mu).f over the cones, that is, f = P(-(B' lambda + A' mu) / w). The
    rows with a multiplier get their bound where they are, the others far away, and h = lambda - K' nu - H y makes
    lambda the gradient.
    """
    rng = np.random.default_rng(seed)
    feet = np.array([[0.18, -0.13, -0.26], [0.18, 0.13, -0.26], [-0.18, -0.13, -0.26], [-0.18, 0.13, -0.26]])
    levers = jnp.asarray(feet + 0.03 * rng.normal(size=(NODES, 4, 3)), jnp.float32)
    B = np.array(force_map(jnp.float32(12.4), jnp.diag(jnp.array([0.14, 0.37, 0.40])), levers), float)
    contact = (rng.random((NODES, 4)) < 0.7).astype(float)
    weight, friction, force_max = 1e-3, 0.5, 80.0
    wanted = np.tile([0.0, 0.0, 50.0], (NODES, 4)) + 30 * rng.normal(size=(NODES, 12))
    gradient = np.einsum("kif,kf->ki", np.linalg.pinv(B.transpose(0, 2, 1)), -weight * wanted)
    A = 0.2 * np.linalg.qr(rng.normal(size=(NODES, 4, 3, 3)))[0]

    def forces_at(multiplier: np.ndarray) -> np.ndarray:
        pull = np.einsum("kif,ki->kf", B, gradient).reshape(NODES, 4, 3) + np.einsum("klij,kli->klj", A, multiplier)
        with jax.enable_x64(True):
            inside = project_cone(jnp.asarray(-pull / weight), jnp.float64(friction), jnp.float64(force_max))
        return np.array(inside) * contact[..., None]

    side = np.sign(np.einsum("klij,klj->kli", A, forces_at(np.zeros((NODES, 4, 3)))))
    multiplier = side * rng.uniform(0, 0.01, (NODES, 4, 3)) * (rng.random((NODES, 4, 3)) < 0.2) * contact[..., None]
    forces = forces_at(multiplier)
    torque = np.einsum("klij,klj->kli", A, forces)
    sign_kept = np.sign(torque) == np.sign(multiplier)
    if not sign_kept[multiplier != 0].all():  # a multiplier so large that it turned its torque around
        return backward_problem(seed + 1000)
    upper = np.where(multiplier > 0, torque, np.abs(torque) + 1.0)
    lower = np.where(multiplier < 0, torque, -np.abs(torque) - 1.0)

    wrench = np.einsum("kif,kf->ki", B, forces.reshape(NODES, 12))
    joint_map = rng.normal(size=(NODES, 12, 6)) * 4
    position = np.array(CONSTANTS.response, float) @ wrench
    rows = np.einsum("kij,kj->ki", joint_map, position)
    joint_price = rng.normal(size=(NODES, 12)) * (rng.random((NODES, 12)) < 0.05)
    push = np.array(CONSTANTS.response, float).T @ np.einsum("kij,ki->kj", joint_map, joint_price)
    linear = gradient - push - (np.array(CONSTANTS.hessian, float) @ wrench.reshape(-1)).reshape(NODES, 6)
    arrays = (
        linear,
        B,
        contact,
        friction,
        force_max,
        weight,
        TorqueRows(A, lower, upper),
        JointRows(joint_map, np.where(joint_price < 0, rows, rows - 0.1), np.where(joint_price > 0, rows, rows + 0.1)),
    )
    return jax.tree.map(lambda values: jnp.asarray(values, jnp.float32), Qp(*arrays)), forces.reshape(NODES, 12)


@pytest.mark.parametrize("iterations_limits", [3000, SETTINGS.iterations_limits])
def test_finds_solutions_that_are_known_beforehand(iterations_limits: int):  # by ADMM, and by Newton's method
    made = [backward_problem(seed) for seed in range(16)]
    qp = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(part for part, _ in made))
    expected = np.stack([forces for _, forces in made])
    solution = compiled(iterations_limits=iterations_limits, tolerance=1e-3)(qp)
    np.testing.assert_array_equal(solution.status, SOLVED)
    assert (np.array(solution.iterations) < (3000 if iterations_limits == 3000 else 100)).all()
    np.testing.assert_allclose(np.array(solution.forces), expected, atol=ACCURATE)
    # They were worth solving: every kind of constraint is active somewhere.
    feet = expected.reshape(16, NODES, 4, 3)
    torque = np.einsum("bklij,bklj->bkli", qp.torque.map, feet)
    assert (np.abs(torque - qp.torque.upper) < 1e-4).any((1, 2, 3)).sum() > 4
    assert (np.abs(feet[..., 2] - 80.0) < 1e-6).any((1, 2)).sum() > 4
    assert (np.hypot(feet[..., 0], feet[..., 1]) > 0.4999 * feet[..., 2]).any()


def test_agrees_with_independent_solvers_on_a_walk(problems: Qp):
    for cone in ("cone", "pyramid"):
        solution = compiled(cone)(problems)
        agree(solution, solve_exactly(problems, cone == "pyramid"))
        check_constraints(problems, solution, cone == "pyramid")
        assert (np.array(solution.iterations) == 0).any()  # more than one pass was needed
        assert (np.array(solution.iterations) > 0).any()


@pytest.mark.slow
@pytest.mark.parametrize("cone", ["cone", "pyramid"])
def test_agrees_with_independent_solvers_on_a_thousand_problems(cone: str):
    from agile_jax.benchmark.workloads.mpc_problems import record_problems
    from agile_jax.control import ControlSettings

    for qp, share in zip(record_problems(ControlSettings(), 1000), (1.0, 0.999), strict=True):
        batch = jax.tree.map(jnp.asarray, qp)
        solution = compiled(cone)(batch)
        check_constraints(batch, solution, cone == "pyramid")
        expected = np.array(solve_exactly(qp, cone == "pyramid"))[:, :12]
        error = np.abs(np.array(solution.forces, float)[:, 0] - expected).max(-1)
        status, feasible = np.array(solution.status), np.isfinite(error)
        assert feasible.sum() >= 999
        assert np.isin(status[~feasible], (INFEASIBLE, UNCONVERGED)).all()
        solved = status == SOLVED
        assert np.mean((solved & (error < ACCURATE))[feasible]) >= share
        assert (error[solved] < 0.3).all()  # what is not accurate says so


def tighten(qp: Qp, constraint: str) -> Qp:
    """Move one kind of bound so that it binds on problems of a walk."""
    if constraint == "friction":
        return qp._replace(friction=0 * qp.friction + 0.06)
    if constraint == "normal force":
        return qp._replace(force_max=0 * qp.force_max + 50.0)
    if constraint == "torque":
        rows = qp.torque
        return qp._replace(torque=rows._replace(lower=rows.lower / 3.2, upper=rows.upper / 3.2))
    # A standing foot's joints in the middle of the horizon are to stay 0.01 rad below where they would go.
    node = NODES // 2
    wrench = jnp.einsum("bkif,bkf->bki", qp.force_map, compiled()(qp).forces)
    rows = jnp.einsum("bij,bj->bi", qp.joint.map[:, node], jnp.einsum("j,bja->ba", CONSTANTS.response[node], wrench))
    stands = jnp.isfinite(qp.joint.upper[:, node])
    upper = qp.joint.upper.at[:, node].set(jnp.where(stands, rows - 0.01, jnp.inf))
    return qp._replace(joint=qp.joint._replace(upper=upper))


def slack(qp: Qp, forces: list[np.ndarray], constraint: str) -> np.ndarray:
    """Smallest distance to the bound in each problem, in units of the constraint."""
    found = []
    for i, force in enumerate(forces):
        problem = dense_qp(CONSTANTS, qp, i)
        x = force[problem.columns]
        feet = x.reshape(-1, 3)
        rows = problem.A @ x
        over = np.minimum(rows - problem.lower, problem.upper - rows)
        torque, joint = np.split(over, 2)
        distance = {
            "friction": problem.friction * feet[:, 2] - np.hypot(feet[:, 0], feet[:, 1]),
            "normal force": problem.force_max - feet[:, 2],
            "torque": torque,
            "joint position": joint,
        }
        found.append(distance[constraint].min())
    return np.array(found)


@pytest.mark.parametrize("constraint", ["friction", "normal force", "torque", "joint position"])
def test_each_constraint_is_kept_where_it_binds(recorded: Any, constraint: str):
    loose = jax.tree.map(lambda values: jnp.asarray(values[:16]), recorded.calm)
    tight = tighten(loose, constraint)
    expected = solve_exactly(tight, pyramid=False)
    binding = np.abs(slack(tight, expected, constraint)) < 1e-3
    assert binding.sum() >= 4
    # Without the bound the optimum breaks it.
    free = slack(tight, solve_exactly(loose, pyramid=False), constraint)
    assert (free[binding] < -1e-3).mean() > 0.7
    solution = compiled(iterations_limits=3000, tolerance=1e-3)(tight)  # tighter than any walk
    agree(solution, expected)
    check_constraints(tight, solution)
    assert (
        np.abs(slack(tight, list(np.array(solution.forces, float).reshape(16, -1)), constraint)[binding]).max() < 0.05
    )


def test_an_infeasible_problem_is_reported_and_its_neighbours_solved(recorded: Any):
    batch = jax.tree.map(lambda values: jnp.asarray(values[:8]), recorded.calm)
    joint = batch.joint
    stands = jnp.isfinite(joint.lower[2])
    impossible = joint._replace(
        lower=joint.lower.at[2].set(jnp.where(stands, joint.upper[2] - 0.05, -jnp.inf)),
    )
    solution = compiled()(batch._replace(joint=impossible))
    others = np.arange(8) != 2
    assert solution.status[2] in (INFEASIBLE, UNCONVERGED)
    assert solution.joint_violation[2] > 0.05
    np.testing.assert_array_equal(np.array(solution.status)[others], SOLVED)
    np.testing.assert_array_equal(np.array(solution.forces)[others], np.array(compiled()(batch).forces)[others])
    check_constraints(batch._replace(joint=impossible), solution)  # cones and torques are kept even so


def test_too_few_iterations_are_reported(recorded: Any):
    hard = jax.tree.map(jnp.asarray, recorded.hard)
    solution = compiled(iterations_limits=10, newton_steps=1)(hard)
    assert (solution.status == UNCONVERGED).any()
    check_constraints(hard, solution)
    residual = np.maximum(solution.primal_residual, solution.dual_residual)
    np.testing.assert_array_equal(residual > SETTINGS.tolerance, np.array(solution.status) == UNCONVERGED)


def test_numbers_that_are_none_end_and_stay_where_they_are(recorded: Any):
    batch = jax.tree.map(lambda values: jnp.asarray(values[:8]), recorded.calm)
    poisoned = batch._replace(linear=batch.linear.at[5, 3, 2].set(jnp.nan))
    solution = compiled()(poisoned)
    assert solution.status[5] == NOT_FINITE
    np.testing.assert_array_equal(solution.forces[5], 0.0)
    assert all(np.isfinite(part).all() for part in solution.warm_start)
    others = np.arange(8) != 5
    np.testing.assert_array_equal(np.array(solution.forces)[others], np.array(compiled()(batch).forces)[others])


def test_a_problem_alone_and_in_any_batch_has_one_solution(problems: Qp):
    together = compiled()(problems)
    turned = compiled()(jax.tree.map(lambda values: values[::-1], problems))
    # Other shapes are rounded differently, which moves where the iterations stop by less than their tolerance.
    np.testing.assert_allclose(turned.forces[::-1], together.forces, atol=SETTINGS.tolerance)
    np.testing.assert_array_equal(turned.iterations[::-1], together.iterations)
    solve = make_solver(CONSTANTS, SETTINGS)
    alone = jax.jit(lambda qp: solve(qp, cold_start(NODES)))
    for i in (0, 20, 31):
        one = alone(jax.tree.map(lambda values, i=i: values[i], problems))
        np.testing.assert_allclose(one.forces, together.forces[i], atol=SETTINGS.tolerance)


def test_blocks_are_put_together_in_order():
    def solve(values: jax.Array, other: jax.Array) -> tuple[jax.Array, jax.Array]:
        return values * 2, other.sum(0)

    values, other = np.arange(3 * 150.0).reshape(3, 150), np.arange(2 * 150.0).reshape(2, 150)
    for size in (5, 64, 128, 150):
        doubled, total = in_blocks(solve, jnp.asarray(values[:, :size]), jnp.asarray(other[:, :size]))
        np.testing.assert_array_equal(doubled, 2 * values[:, :size])
        np.testing.assert_array_equal(total, other[:, :size].sum(0))


def test_a_shifted_start_moves_along_the_horizon():
    values = jnp.arange(NODES, dtype=jnp.float32)[:, None, None] * jnp.ones((NODES, 4, 3))
    moved = shift(WarmStart(values, 2 * values), 2 / 3).forces[:, 0, 0]
    np.testing.assert_allclose(moved, np.minimum(np.arange(NODES) + 2 / 3, NODES - 1), rtol=1e-5)
    np.testing.assert_array_equal(shift(WarmStart(values, values), 1.0).multipliers[:-1], values[1:])
