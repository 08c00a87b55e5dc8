"""Box distances against brute force, NumPy against JAX, and rotations against each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.geometry import (
    prism_distance,
    quaternion_to_matrix,
    quaternion_to_rpy,
    rectangle_distance,
    rotation_2d,
    support,
    wrap_angle,
    yaw_to_quaternion,
)


def random_rectangles(n, seed):
    generator = np.random.default_rng(seed)
    return (
        generator.uniform(-1, 1, (n, 2)),
        generator.uniform(0.1, 0.5, (n, 2)),
        generator.uniform(-4, 4, n),
        generator.uniform(-1, 1, (n, 2)),
        generator.uniform(0.1, 0.5, (n, 2)),
        generator.uniform(-4, 4, n),
    )


def boundary(center, half, yaw, n=400):
    """Points on the edge of a rectangle, shape (4 n, 2)."""
    t = np.linspace(-1, 1, n)
    edges = [np.stack([t, np.full(n, s)], -1) for s in (-1, 1)] + [np.stack([np.full(n, s), t], -1) for s in (-1, 1)]
    return center + (np.concatenate(edges) * half) @ rotation_2d(yaw).T


def inside(points, center, half, yaw):
    return (np.abs((points - center) @ rotation_2d(yaw)) <= half).all(-1)


def test_distance_of_disjoint_rectangles_is_that_of_sampled_edges():
    args = random_rectangles(150, 0)
    distances = rectangle_distance(*args)
    assert (distances > 0.05).sum() > 50
    for k in np.flatnonzero(distances > 0):
        a, b = boundary(*(x[k] for x in args[:3])), boundary(*(x[k] for x in args[3:]))
        nearest = np.sqrt(((a[:, None, :] - b[None, ::4, :]) ** 2).sum(-1)).min()
        assert distances[k] - 1e-12 <= nearest <= distances[k] + 5e-3


def test_penetration_depth_is_the_shortest_translation_that_parts():
    args = random_rectangles(200, 1)
    distances = rectangle_distance(*args)
    overlapping = np.flatnonzero(distances < -0.02)
    assert len(overlapping) > 30
    angles = np.linspace(0, 2 * np.pi, 721)
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    for k in overlapping[:40]:
        depth = -distances[k]
        ca, ha, ya, cb, hb, yb = (x[k] for x in args)
        n = len(directions)
        repeat = (np.tile(ha, (n, 1)), np.full(n, ya), np.tile(cb, (n, 1)), np.tile(hb, (n, 1)), np.full(n, yb))
        assert (rectangle_distance(ca + 0.98 * depth * directions, *repeat) < 0).all()
        assert rectangle_distance(ca + 1.01 * depth * directions, *repeat).max() > -1e-3


def test_sign_agrees_with_sampled_interiors():
    args = random_rectangles(200, 2)
    distances = rectangle_distance(*args)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 2), -1).reshape(-1, 2)
    for k in range(200):
        ca, ha, ya, cb, hb, yb = (x[k] for x in args)
        volume = ca + (grid * ha) @ rotation_2d(ya).T
        if inside(volume, cb, hb, yb).any():
            assert distances[k] <= 0
        elif distances[k] < 0:
            assert distances[k] > -0.05  # between the points of the grid


def test_jax_agrees_and_has_finite_gradients():
    args = random_rectangles(100, 3)
    ours = rectangle_distance(*args)
    compiled = jax.jit(lambda *a: rectangle_distance(*a, xp=jnp))(*args)
    np.testing.assert_allclose(compiled, ours, atol=3e-6)
    gradient = jax.vmap(jax.grad(lambda *a: rectangle_distance(*a, xp=jnp)))(*(jnp.asarray(x) for x in args))
    assert np.isfinite(gradient).all()


def test_touching_rectangles_have_distance_zero():
    d = rectangle_distance(np.zeros(2), np.ones(2), np.array(0.0), np.array([2.0, 0.5]), np.ones(2), np.array(0.0))
    assert d == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    ("planar", "vertical", "expected"),
    [(3.0, 4.0, 5.0), (3.0, -1.0, 3.0), (-1.0, 2.0, 2.0), (-1.0, -2.0, -1.0), (0.0, -1.0, 0.0)],
)
def test_prism_distance(planar, vertical, expected):
    assert prism_distance(np.array(planar), np.array(vertical)) == pytest.approx(expected)


def test_wrap_angle():
    angles = np.array([0.0, np.pi, -np.pi, 3 * np.pi / 2, -7.0, 100.0])
    wrapped = wrap_angle(angles)
    assert ((wrapped >= -np.pi) & (wrapped < np.pi)).all()
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles), atol=1e-12)


def test_quaternions_matrices_and_angles_agree():
    generator = np.random.default_rng(4)
    rpy = np.stack([generator.uniform(-3, 3, 50), generator.uniform(-1.5, 1.5, 50), generator.uniform(-3, 3, 50)], -1)
    half = rpy / 2
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    quaternion = np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        -1,
    )
    np.testing.assert_allclose(quaternion_to_rpy(quaternion), rpy, atol=1e-9)
    matrix = quaternion_to_matrix(quaternion)
    np.testing.assert_allclose(matrix @ np.swapaxes(matrix, -1, -2), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrix), 1)
    yaw = np.array([0.3, -2.0])
    np.testing.assert_allclose(quaternion_to_matrix(yaw_to_quaternion(yaw))[:, :2, :2], rotation_2d(yaw), atol=1e-12)


def test_support_is_the_farthest_corner():
    """Along any direction, whatever the turn; and NumPy's answer is JAX's."""
    generator = np.random.default_rng(5)
    half, yaw, angle = np.array([0.28, 0.155]), generator.uniform(-4, 4, 100), generator.uniform(-4, 4, 100)
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    corners = (half * [[1, 1], [1, -1], [-1, 1], [-1, -1]]) @ np.swapaxes(rotation_2d(yaw), -1, -2)
    np.testing.assert_allclose(support(half, normal, yaw), np.einsum("nij,nj->ni", corners, normal).max(-1), atol=1e-12)
    np.testing.assert_allclose(support(jnp.array(half), normal, yaw, jnp), support(half, normal, yaw), atol=1e-6)
