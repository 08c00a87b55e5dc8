import numpy as np
import pytest

from agile_jax.policy import noise_floor


def lines(count, nodes, dimension=4, seed=0):
    """Straight trajectories through the unit cube, shape (count, nodes, dimension)."""
    generator = np.random.default_rng(seed)
    start, end = generator.random((2, count, 1, dimension))
    return start + np.linspace(0, 1, nodes)[:, None] * (end - start)


def field(poses):
    return np.sin(2 * poses[..., [1, 0, 3, 2]]) + poses


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_floor_is_the_variance_that_the_trajectories_differ_by(sigma):
    """Each trajectory has its own offset: no function of the position, though smooth along the trajectory."""
    poses = lines(300, 40)
    offset = np.random.default_rng(1).normal(scale=sigma, size=(300, 1, 4))
    assert noise_floor(poses, field(poses) + offset) == pytest.approx(sigma**2, rel=0.25)


def test_floor_of_a_pure_function_of_the_position_is_far_below_its_variance():
    poses = lines(300, 40)
    assert noise_floor(poses, field(poses)) < 0.01 * field(poses).var(axis=(0, 1)).mean()


def test_neighbours_on_the_same_trajectory_do_not_count():
    """In one dimension neighbours of other trajectories are at hand everywhere; own ones would give zero."""
    poses = lines(50, 200, dimension=1)
    offset = np.random.default_rng(1).normal(size=(50, 1, 1))
    expected = offset.var()
    assert noise_floor(poses, np.broadcast_to(offset, poses.shape)) == pytest.approx(expected, rel=0.3)


def test_subtracting_a_function_of_the_position_sharpens_the_estimate():
    poses = lines(60, 40)
    offset = np.random.default_rng(2).normal(scale=0.05, size=(60, 1, 4))
    steep = 5 * field(poses)
    bare, helped = noise_floor(poses, steep + offset), noise_floor(poses, offset + 0 * steep)
    assert abs(helped - 0.05**2) < abs(bare - 0.05**2)
    assert helped == pytest.approx(0.05**2, rel=0.3)


def test_two_trajectories_are_too_few():
    with pytest.raises(ValueError, match="at least 3"):
        noise_floor(lines(2, 5), lines(2, 5))
