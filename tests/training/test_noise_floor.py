import numpy as np
import pytest

from agile_jax.training import gamma_test


def lines(count, nodes, dimension=4, seed=0):
    """Straight trajectories through the unit cube, shape (count, nodes, dimension)."""
    generator = np.random.default_rng(seed)
    start, end = generator.random((2, count, 1, dimension))
    return start + np.linspace(0, 1, nodes)[:, None] * (end - start)


def floor(*arguments):
    return gamma_test(*arguments).floor


def field(poses):
    return np.sin(2 * poses[..., [1, 0, 3, 2]]) + poses


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_floor_is_the_variance_that_the_trajectories_differ_by(sigma):
    """Each trajectory has its own offset: no function of the position, though smooth along the trajectory."""
    poses = lines(300, 40)
    offset = np.random.default_rng(1).normal(scale=sigma, size=(300, 1, 4))
    assert floor(poses, field(poses) + offset) == pytest.approx(sigma**2, rel=0.25)


def test_floor_of_a_pure_function_of_the_position_is_far_below_its_variance():
    poses = lines(300, 40)
    assert floor(poses, field(poses)) < 0.01 * field(poses).var(axis=(0, 1)).mean()


def test_neighbours_on_the_same_trajectory_do_not_count():
    """In one dimension neighbours of other trajectories are at hand everywhere; own ones would give zero."""
    poses = lines(50, 200, dimension=1)
    offset = np.random.default_rng(1).normal(size=(50, 1, 1))
    expected = offset.var()
    assert floor(poses, np.broadcast_to(offset, poses.shape)) == pytest.approx(expected, rel=0.3)


def test_subtracting_a_function_of_the_position_sharpens_the_estimate():
    poses = lines(60, 40)
    offset = np.random.default_rng(2).normal(scale=0.05, size=(60, 1, 4))
    steep = 5 * field(poses)
    bare, helped = floor(poses, steep + offset), floor(poses, offset + 0 * steep)
    assert abs(helped - 0.05**2) < abs(bare - 0.05**2)
    assert helped == pytest.approx(0.05**2, rel=0.3)


def test_two_trajectories_are_too_few():
    with pytest.raises(ValueError, match="at least 3"):
        floor(lines(2, 5), lines(2, 5))


@pytest.mark.parametrize(("count", "steepness"), [(30, 1), (30, 4), (100, 4), (300, 1), (300, 4), (1000, 2)])
@pytest.mark.parametrize("sigma", [0.0, 0.02, 0.1, 0.4])
def test_the_estimate_errs_upwards_and_is_right_where_its_share_is_large(count, steepness, sigma):
    poses = lines(count, 20)
    offset = np.random.default_rng(3).normal(scale=sigma, size=(count, 1, 4))
    found = gamma_test(poses, np.sin(steepness * poses[..., [1, 0, 3, 2]]) * 2 + offset)
    known = offset.var(axis=0, ddof=1).mean()
    assert found.floor > 0.5 * known or known == 0
    if found.share > 0.5:
        assert found.floor == pytest.approx(known, rel=0.3)
    else:
        assert sigma < 0.4  # a floor that is hard to see is a low one
