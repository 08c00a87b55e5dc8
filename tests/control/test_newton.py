"""The third pass: derivatives of projections, the search along a step, and the system that a step solves."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control.mpc.problem import mpc_constants
from agile_jax.control.mpc.solver.linear_system import BATCHED, Multipliers, newton_step, solve
from agile_jax.control.mpc.solver.newton import (
    LINE_SEARCH,
    REGULARISATION,
    factorise_active,
    first_zero,
    point_at,
    projection_derivative,
)
from agile_jax.control.mpc.solver.projection import PROJECTIONS
from agile_jax.control.mpc.solver.scaled_qp import scale
from agile_jax.control.settings import MpcSettings

CONSTANTS = mpc_constants(MpcSettings())


@pytest.fixture(scope="module")
def batch(recorded: Any) -> Any:
    """Four scaled problems, the batch last."""
    qps = jax.tree.map(lambda values: jnp.asarray(values[:4]), recorded.hard)
    return jax.vmap(scale, 0, -1)(qps)


@pytest.mark.parametrize("cone", ["cone", "pyramid"])
def test_the_derivative_of_a_projection_is_that_of_small_differences(cone: str, batch: Any):
    rng = np.random.default_rng(0)
    forces = jnp.asarray(rng.normal(size=batch.torque.lower.shape) * np.array([2.0, 2.0, 4.0])[:, None], jnp.float32)
    derivative = np.asarray(projection_derivative(batch, PROJECTIONS[cone], forces))
    direction = rng.normal(size=forces.shape)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    h = 1e-2
    ahead, behind = (batch.project(PROJECTIONS[cone], forces + sign * h * direction) for sign in (1, -1))
    expected = np.asarray(ahead - behind) / (2 * h)
    error = np.abs(np.einsum("klijb,kljb->klib", derivative, direction) - expected).max(2)
    assert np.quantile(error, 0.9) < 1e-2  # the others have a kink within the difference
    # It is a projection's: symmetric, with eigenvalues from 0 to 1.
    matrices = np.moveaxis(derivative, -1, 0)
    np.testing.assert_allclose(matrices, np.swapaxes(matrices, -1, -2), atol=1e-5)
    eigenvalues = np.linalg.eigvalsh(matrices)
    assert eigenvalues.min() > -1e-5
    assert eigenvalues.max() < 1 + 1e-5


def test_a_step_solves_its_system(batch: Any):
    """Against the Hessian of the augmented Lagrangian, column by column."""
    rng = np.random.default_rng(1)
    penalties = Multipliers(*(jnp.full(4, value) for value in (6.0, 3.0, 100.0)))
    forces = jnp.asarray(rng.normal(size=batch.torque.lower.shape), jnp.float32)
    derivative = projection_derivative(batch, PROJECTIONS["cone"], forces)
    mask = jnp.asarray(rng.integers(0, 2, forces.shape), jnp.float32)
    rows = jnp.asarray(rng.integers(0, 2, batch.joint.lower.shape), jnp.float32)
    active = Multipliers(forces, mask, rows)
    factors = jax.vmap(factorise_active, (None, -1, -1, -1, -1), BATCHED)(
        CONSTANTS, batch, derivative, active, penalties
    )

    def hessian(g: jax.Array) -> jax.Array:
        point = point_at(CONSTANTS, batch, g)
        pull = batch.gradient(CONSTANTS, point.wrench) - batch.linear
        pull += batch.joints_transposed(CONSTANTS, penalties.joint * rows * point.joints)
        cone = penalties.cone * (g - jnp.einsum("klijb,kljb->klib", derivative, g))
        torque = batch.torques_transposed(penalties.torque * mask * point.torques)
        return (batch.force_weight + REGULARISATION) * g + batch.wrench_transposed(pull) + cone + torque

    gradient = hessian(forces)
    step = newton_step(
        batch, factors.foot, lambda wrench: jax.vmap(solve, (BATCHED, -1), -1)(factors, wrench), gradient
    )
    np.testing.assert_allclose(step, -forces, atol=2e-2)


@pytest.mark.parametrize("zero", [0.02, 0.25, 0.6, 0.97])
def test_a_step_goes_to_where_its_slope_vanishes(zero: float):
    slopes = jnp.array([3.0 * (part - zero) for part in LINE_SEARCH])
    kinked = jnp.array([(1.0 if part < zero else 9.0) * (part - zero) for part in LINE_SEARCH])
    found = np.asarray(first_zero(jnp.array([-3 * zero, -zero]), jnp.stack([slopes, kinked], -1)))
    assert found[0] == pytest.approx(zero, abs=1e-6 if zero < 0.9 else 0.04)
    before = max([0.0, *(part for part in LINE_SEARCH if part < zero)])
    after = min(part for part in LINE_SEARCH if part > zero)
    assert before <= found[1] <= after


def test_a_step_that_stays_downhill_is_taken_whole():
    downhill = jnp.array([-1.0 + part for part in LINE_SEARCH])[:, None]
    assert first_zero(jnp.array([-1.0]), downhill)[0] == 1.0
