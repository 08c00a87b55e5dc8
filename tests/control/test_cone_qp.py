"""The MPC's problem and its solver, against simulation, an independent solver, and the geometry of projections."""

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import MpcSettings
from agile_jax.control.centroidal import BodyState, double_integrator_response, force_map
from agile_jax.control.cone_qp import Qp, cold_start, project, solve
from agile_jax.control.mpc import build_qp, mpc_constants

SETTINGS = MpcSettings()
NODES = SETTINGS.horizon
MASS = 12.453
INERTIA = np.diag([0.14, 0.37, 0.40])
FEET = np.array([[0.18, -0.13, -0.26], [0.18, 0.13, -0.26], [-0.18, -0.13, -0.26], [-0.18, 0.13, -0.26]])


def make_problem(seed: int, spread: float) -> tuple[Qp, BodyState, BodyState]:
    """A trotting robot off its reference by a random state of size `spread`."""
    rng = np.random.default_rng(seed)
    contact = np.where((np.arange(NODES) // 5 % 2)[:, None] == 0, [1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0])
    position = np.array([0, 0, 0, 0, 0, 0.26]) + spread * rng.normal(size=6) * [0.1, 0.1, 0.1, 0.03, 0.03, 0.02]
    velocity = spread * rng.normal(size=6) * [0.5, 0.5, 0.5, 0.3, 0.3, 0.2]
    body = BodyState(jnp.asarray(position, jnp.float32), jnp.asarray(velocity, jnp.float32))
    steps = np.arange(1, NODES + 1)[:, None] * SETTINGS.mpc_dt
    target = np.array([0.5, 0, 0])
    reference = BodyState(
        jnp.asarray(np.concatenate([np.zeros((NODES, 3)), steps * target + [0, 0, 0.26]], -1), jnp.float32),
        jnp.asarray(np.tile([0, 0, 0, *target], (NODES, 1)), jnp.float32),
    )
    levers = FEET + 0.03 * rng.normal(size=(NODES, 4, 3))
    qp = build_qp(
        mpc_constants(SETTINGS),
        SETTINGS,
        body,
        reference,
        jnp.float32(MASS),
        jnp.asarray(INERTIA, jnp.float32),
        jnp.asarray(levers, jnp.float32),
        jnp.asarray(contact, jnp.float32),
    )
    return qp, body, reference


def tracking_cost(qp: Qp, body: BodyState, reference: BodyState, forces: np.ndarray) -> float:
    """Half the cost of the MPC by stepping the dynamics one by one: the second implementation."""
    position, velocity = np.array(body.position, float), np.array(body.velocity, float)
    weight_p = np.array(SETTINGS.weight_orientation + SETTINGS.weight_position)
    weight_v = np.array(SETTINGS.weight_angular_velocity + SETTINGS.weight_velocity)
    dt, cost = SETTINGS.mpc_dt, 0.0
    for node in range(NODES):
        acceleration = np.array(qp.force_map[node], float) @ forces[node] - [0, 0, 0, 0, 0, 9.81]
        position = position + dt * velocity + dt**2 / 2 * acceleration
        velocity = velocity + dt * acceleration
        cost += weight_p @ (position - np.array(reference.position[node])) ** 2
        cost += weight_v @ (velocity - np.array(reference.velocity[node])) ** 2
        cost += SETTINGS.weight_force * forces[node] @ forces[node]
    return cost / 2


def test_condensed_cost_equals_stepping_the_dynamics():
    qp, body, reference = make_problem(0, 1.0)
    hessian = np.linalg.inv(np.array(qp.hessian_inverse, float))
    rng = np.random.default_rng(1)

    def condensed(forces: np.ndarray) -> float:
        y = np.einsum("kif,kf->ki", np.array(qp.force_map, float), forces).reshape(-1)
        return (
            0.5 * y @ hessian @ y
            + np.array(qp.linear, float).reshape(-1) @ y
            + 0.5 * SETTINGS.weight_force * (forces**2).sum()
        )

    zero = np.zeros((NODES, 12))
    for _ in range(5):
        forces = 30 * rng.normal(size=(NODES, 12))
        expected = tracking_cost(qp, body, reference, forces) - tracking_cost(qp, body, reference, zero)
        assert condensed(forces) == pytest.approx(expected, rel=2e-4, abs=1e-3)


def test_response_of_the_double_integrator_is_exact():
    response = double_integrator_response(7, 0.03)
    acceleration = np.random.default_rng(0).normal(size=7)
    position = velocity = 0.0
    for node in range(7):
        position += 0.03 * velocity + 0.03**2 / 2 * acceleration[node]
        velocity += 0.03 * acceleration[node]
        assert response.position[node] @ acceleration == pytest.approx(position, abs=1e-15)
        assert response.velocity[node] @ acceleration == pytest.approx(velocity, abs=1e-15)


def test_force_map_is_newton_and_euler():
    forces = np.random.default_rng(0).normal(size=(4, 3))
    acceleration = force_map(jnp.float32(MASS), jnp.asarray(INERTIA), jnp.asarray(FEET)) @ forces.reshape(-1)
    np.testing.assert_allclose(acceleration[3:], forces.sum(0) / MASS, rtol=1e-5)
    torque = np.cross(FEET, forces).sum(0)
    np.testing.assert_allclose(acceleration[:3], np.linalg.solve(INERTIA, torque), rtol=1e-4, atol=1e-5)


def test_projection_is_feasible_and_nearest():
    """p is the projection of x onto a convex set iff (x - p).(q - p) <= 0 for every q of the set."""
    rng = np.random.default_rng(0)
    friction, force_max = 0.5, 5.0
    points = rng.normal(size=(500, 3)) * 6
    projected = np.array(project(jnp.asarray(points), jnp.ones(500), friction, force_max), float)
    assert (np.hypot(projected[:, 0], projected[:, 1]) <= friction * projected[:, 2] + 1e-5).all()
    assert (projected[:, 2] >= 0).all()
    assert (projected[:, 2] <= force_max).all()
    height = rng.uniform(0, force_max, 400)
    radius, angle = friction * height * rng.uniform(0, 1, 400), rng.uniform(0, 2 * np.pi, 400)
    members = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1)
    products = np.einsum("pi,pqi->pq", points - projected, members[None] - projected[:, None])
    assert products.max() < 1e-3
    np.testing.assert_array_equal(project(jnp.asarray(points), jnp.zeros(500), friction, force_max), 0.0)


def reference_solution(qp: Qp) -> np.ndarray:
    """The same problem by IPOPT, in float64."""
    hessian = np.linalg.inv(np.array(qp.hessian_inverse, float))
    forces = ca.MX.sym("f", 12 * NODES)
    blocks = [np.array(qp.force_map[k], float) for k in range(NODES)]
    y = ca.vertcat(*[ca.DM(blocks[k]) @ forces[12 * k : 12 * k + 12] for k in range(NODES)])
    cost = 0.5 * ca.bilin(ca.DM(hessian), y, y) + ca.dot(ca.DM(np.array(qp.linear, float).reshape(-1)), y)
    cost += 0.5 * SETTINGS.weight_force * ca.sumsqr(forces)
    lower, upper, cones = [], [], []
    for k in range(NODES):
        for leg in range(4):
            stands = float(qp.contact[k, leg])
            lower += [-ca.inf * stands if stands else 0.0] * 2 + [0.0]
            upper += [ca.inf if stands else 0.0] * 2 + [SETTINGS.force_max * stands]
            f = forces[12 * k + 3 * leg : 12 * k + 3 * leg + 3]
            if stands:
                cones.append((SETTINGS.friction * f[2]) ** 2 - f[0] ** 2 - f[1] ** 2)
    options = {"ipopt.print_level": 0, "print_time": False, "ipopt.tol": 1e-9, "ipopt.sb": "yes"}
    solver = ca.nlpsol("qp", "ipopt", {"x": forces, "f": cost, "g": ca.vertcat(*cones)}, options)
    start = np.tile([0.0, 0.0, 60.0], 4 * NODES)
    result = solver(x0=start, lbx=lower, ubx=upper, lbg=0.0, ubg=ca.inf)
    assert solver.stats()["success"]
    return np.array(result["x"]).reshape(NODES, 12)


@pytest.mark.parametrize(("seed", "spread"), [(0, 0.3), (1, 1.0), (2, 2.0)])
def test_solution_agrees_with_an_independent_solver(seed: int, spread: float):
    qp, body, reference = make_problem(seed, spread)
    solution = jax.jit(lambda qp: solve(qp, cold_start(NODES), 200))(qp)
    forces = np.array(solution.forces, float)
    expected = reference_solution(qp)
    # The force that is applied, and the cost: later nodes are flat directions.
    np.testing.assert_allclose(forces[0], expected[0], atol=0.5)
    best = tracking_cost(qp, body, reference, expected)
    assert tracking_cost(qp, body, reference, forces) <= best * (1 + 1e-3) + 1e-3


def test_forces_are_inside_their_cones_after_any_number_of_iterations():
    problems = [make_problem(seed, 3.0)[0] for seed in range(20)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *problems)
    solution = jax.jit(jax.vmap(lambda qp: solve(qp, cold_start(NODES), 5)))(batch)
    forces = np.array(solution.forces).reshape(20, NODES, 4, 3)
    assert (np.hypot(forces[..., 0], forces[..., 1]) <= SETTINGS.friction * forces[..., 2] + 1e-3).all()
    assert (forces[..., 2] <= SETTINGS.force_max + 1e-3).all()
    np.testing.assert_array_equal(forces[np.array(batch.contact) == 0], 0.0)
    assert np.isfinite(solution.primal_residual).all()
