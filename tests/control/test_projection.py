"""Projections onto cone and pyramid: feasible, and nearest, by the variational inequality of projections."""

import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control.mpc.solver.projection import PROJECTIONS, shrink_into

FRICTION, FORCE_MAX = 0.5, 5.0


def members(kind: str, count: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    height = rng.uniform(0, FORCE_MAX, count) ** 1.0
    height[::4] = FORCE_MAX
    if kind == "pyramid":
        return np.concatenate([FRICTION * height[:, None] * rng.choice([-1, 1, 0.3], (count, 2)), height[:, None]], -1)
    radius, angle = FRICTION * height * rng.choice([1, 0.4], count), rng.uniform(0, 2 * np.pi, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1)


@pytest.mark.parametrize("kind", PROJECTIONS)
def test_projection_is_feasible_and_nearest(kind: str):
    """p is the projection of x onto a convex set iff (x - p).(q - p) <= 0 for every q of the set."""
    points = np.random.default_rng(0).normal(size=(125, 4, 3)) * 6
    projected = np.array(PROJECTIONS[kind](jnp.asarray(points), FRICTION, FORCE_MAX), float).reshape(-1, 3)
    points = points.reshape(-1, 3)
    size = np.hypot(*projected[:, :2].T) if kind == "cone" else np.abs(projected[:, :2]).max(-1)
    assert (size <= FRICTION * projected[:, 2] + 1e-5).all()
    assert (projected[:, 2] >= 0).all()
    assert (projected[:, 2] <= FORCE_MAX).all()
    assert {0.0, FORCE_MAX} <= set(projected[:, 2].tolist())
    q = members(kind, 400)
    products = np.einsum("pi,pqi->pq", points - projected, q[None] - projected[:, None])
    assert products.max() < 1e-3


@pytest.mark.parametrize("kind", PROJECTIONS)
def test_a_trailing_batch_is_projected_alike(kind: str):
    points = jnp.asarray(np.random.default_rng(0).normal(size=(7, 4, 3, 5)) * 6)
    friction, force_max = jnp.linspace(0.3, 0.7, 5), jnp.linspace(2.0, 6.0, 5)
    together = PROJECTIONS[kind](points, friction, force_max)
    for i in range(5):
        np.testing.assert_allclose(together[..., i], PROJECTIONS[kind](points[..., i], friction[i], force_max[i]))


def test_shrinking_keeps_bounds_and_direction():
    rng = np.random.default_rng(0)
    force, rows = rng.normal(size=(50, 4, 3)), rng.normal(size=(50, 4, 3, 3))
    lower, upper = -rng.uniform(0, 2, (50, 4, 3)), rng.uniform(0, 2, (50, 4, 3))
    image = np.einsum("klij,klj->kli", rows, force)
    shrunk = np.array(shrink_into(*(jnp.asarray(part) for part in (force, image, lower, upper))), float)
    after = np.einsum("klij,klj->kli", rows, shrunk)
    assert (after <= upper + 1e-6).all()
    assert (after >= lower - 1e-6).all()
    share = shrunk / force
    np.testing.assert_allclose(share, share[..., :1] * np.ones(3), rtol=1e-4)
    assert (share <= 1 + 1e-6).all()
    inside = ((image >= lower) & (image <= upper)).all(-1)
    np.testing.assert_array_equal(shrunk[inside], force[inside].astype(np.float32))
    assert inside.any()
    assert not inside.all()
