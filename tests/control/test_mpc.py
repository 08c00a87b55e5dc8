"""The MPC's problem against stepping its dynamics one by one."""

import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import MpcSettings
from agile_jax.control.mpc.centroidal import BodyState, double_integrator_response, force_map
from agile_jax.control.mpc.leg_limits import JointRows, TorqueRows
from agile_jax.control.mpc.problem import Qp, build_qp, mpc_constants

SETTINGS = MpcSettings()
NODES = SETTINGS.horizon
MASS = 12.453
INERTIA = np.diag([0.14, 0.37, 0.40])
FEET = np.array([[0.18, -0.13, -0.26], [0.18, 0.13, -0.26], [-0.18, -0.13, -0.26], [-0.18, 0.13, -0.26]])
ROWS = JointRows(*(np.random.default_rng(9).normal(size=(NODES, 12, *rest)) for rest in ([6], [], [])))


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
        TorqueRows(jnp.zeros((NODES, 4, 3, 3)), -jnp.ones((NODES, 4, 3)), jnp.ones((NODES, 4, 3))),
        JointRows(*(jnp.asarray(values, jnp.float32) for values in ROWS)),
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
    constants = mpc_constants(SETTINGS)
    hessian = np.array(constants.hessian, float)
    np.testing.assert_allclose(hessian @ np.array(constants.hessian_inverse, float), np.eye(6 * NODES), atol=1e-3)
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


def test_joint_rows_are_of_the_states_that_the_forces_lead_to():
    qp, body, _ = make_problem(3, 1.0)
    forces = 30 * np.random.default_rng(2).normal(size=(NODES, 12))
    position, velocity, dt = np.array(body.position, float), np.array(body.velocity, float), SETTINGS.mpc_dt
    y = np.einsum("kif,kf->ki", np.array(qp.force_map, float), forces)
    states = []
    for node in range(NODES):
        acceleration = y[node] - [0, 0, 0, 0, 0, 9.81]
        position = position + dt * velocity + dt**2 / 2 * acceleration
        velocity = velocity + dt * acceleration
        states.append(position)
    moved = np.array(mpc_constants(SETTINGS).response, float) @ y
    rows = np.einsum("kij,kj->ki", np.array(qp.joint.map, float), np.array(states))
    # Both bounds are moved by what free fall does to the rows, so what is left of the rows is what the forces add.
    falling = rows - np.einsum("kij,kj->ki", np.array(qp.joint.map, float), moved)
    np.testing.assert_allclose(ROWS.lower - np.array(qp.joint.lower), falling, atol=1e-4)
    np.testing.assert_allclose(ROWS.upper - np.array(qp.joint.upper), falling, atol=1e-4)


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
