import jax
import jax.numpy as jnp
import numpy as np
import pytest
from synthetic import ACCELERATION, LIMITS, SMALL, TARGET, VELOCITY, empty_scene, follow, table_scene

from agile_jax.policy import ResidualField, make_policy
from agile_jax.training import Followed, make_follower
from agile_jax.training.kinematic_test.follow import ARRIVED, COLLIDED, STALLED, TIMEOUT

DT = 0.02


def without_network(scene, field_filter=True):
    settings = SMALL.model_copy(update={"field_filter": field_filter})
    policy = make_policy(scene, LIMITS, settings)
    parameters = policy.init(jax.random.key(0))
    return policy, parameters._replace(network=jax.tree.map(jnp.zeros_like, parameters.network))


def always(speed):
    """A policy that asks for the same speed along x everywhere."""

    class Always(ResidualField):
        def command(self, parameters, pose, velocity, dt):
            return jnp.array([speed, 0.0, 0.0, 0.0])

    return Always(empty_scene(), LIMITS, SMALL)


def test_braking_law_drives_home_in_the_analytic_time():
    scene = empty_scene()
    distances = np.array([2.5, 1.0, 0.3])
    starts = TARGET - distances[:, None] * [1, 0, 0, 0]
    policy, parameters = without_network(scene)
    result = follow(policy, parameters, scene, starts, DT, ACCELERATION, 6.0)
    assert (result.outcome == ARRIVED).all()
    # Rest to rest, less the last centimetre that counts as arrived.
    v, a = VELOCITY[0], ACCELERATION[0]
    time = np.where(distances > v**2 / a, distances / v + v / a, 2 * np.sqrt(distances / a)) - np.sqrt(2 * 0.01 / a)
    np.testing.assert_allclose(result.arrival_time, time, rtol=0.05, atol=0.1)
    assert np.isinf(result.min_clearance).all()


def test_all_axes_arrive_together_and_overshoot_nothing():
    scene = empty_scene()
    starts = np.random.default_rng(0).uniform([-1, -1.5, 0.15, -1], [2.5, 1.5, 0.31, 1], (50, 4))
    policy, parameters = without_network(scene)
    result = follow(policy, parameters, scene, starts, DT, ACCELERATION / 0.92, 10.0)
    assert (result.outcome == ARRIVED).all()
    sign = np.sign(starts - TARGET)
    assert ((result.poses - TARGET) * sign[:, None]).min() > -2e-3


def test_acceleration_stays_within_the_limit():
    scene = empty_scene()
    policy, parameters = without_network(scene)
    result = follow(policy, parameters, scene, TARGET[None] - [[2.0, 1.0, 0.05, 0.5]], DT, ACCELERATION, 6.0)
    # Second differences of the poses are means of two ticks' accelerations.
    acceleration = np.diff(result.poses[0].astype(np.float64), 2, axis=0) / DT**2
    assert (np.abs(acceleration) <= ACCELERATION * 1.01 + 3e-3).all()


def test_straight_line_through_the_table_is_a_collision_and_touches_by_as_much_as_the_clearance_says():
    scene = table_scene()
    policy, parameters = without_network(scene, field_filter=False)
    result = follow(policy, parameters, scene, np.array([[0.0, 0.0, 0.28, 0.0]]), DT, ACCELERATION, 8.0)
    assert result.outcome[0] == COLLIDED
    assert result.min_clearance[0] == pytest.approx(0.25 - 0.28 - scene.torso_half_size[2], abs=1e-4)
    assert np.isfinite(result.arrival_time[0])  # it would have arrived


def test_fields_that_stand_still_or_run_away_are_told_apart():
    scene = empty_scene()
    _, parameters = without_network(scene)
    starts = np.array([[0.0, 0.0, 0.28, 0.0]])
    stand, run, broken = always(0.0), always(0.5), always(np.nan)
    assert follow(stand, parameters, scene, starts, DT, ACCELERATION, 2.0).outcome[0] == STALLED
    assert follow(run, parameters, scene, starts, DT, ACCELERATION, 20.0).outcome[0] == TIMEOUT
    assert follow(broken, parameters, scene, starts, DT, ACCELERATION, 2.0).outcome[0] == TIMEOUT


def test_passing_through_the_target_is_no_arrival():
    scene = empty_scene()
    _, parameters = without_network(scene)
    through = always(0.5)
    result = follow(through, parameters, scene, TARGET[None] - [[1.0, 0, 0, 0]], DT, None, 6.0)
    assert result.outcome[0] == TIMEOUT
    assert np.isinf(result.arrival_time[0])


def test_numbers_do_not_depend_on_how_many_starts_run_and_in_which_order():
    scene = table_scene()
    policy = make_policy(scene, LIMITS, SMALL)
    parameters = policy.init(jax.random.key(1))
    starts = np.random.default_rng(0).uniform([-0.5, -0.8, 0.2, -0.3], [0.8, 0.8, 0.3, 0.3], (300, 4))
    follower = make_follower(policy, scene, 6.0, DT, ACCELERATION / 0.92)
    limits = np.linspace(3.0, 6.0, 300)
    whole, reverse = follower(parameters, starts, limits), follower(parameters, starts[::-1], limits[::-1])
    few = follower(parameters, starts[250:270], limits[250:270])
    for name in Followed._fields:
        np.testing.assert_array_equal(getattr(whole, name), getattr(reverse, name)[::-1])
        np.testing.assert_array_equal(getattr(whole, name)[250:270], getattr(few, name))


def test_a_loop_ends_by_its_own_limit_and_after_it_has_arrived():
    scene = empty_scene()
    policy, parameters = without_network(scene)
    starts = TARGET - np.array([[2.0, 0, 0, 0], [2.0, 0, 0, 0], [0.1, 0, 0, 0]])
    follower = make_follower(policy, scene, 20.0, DT, ACCELERATION)
    result = follower(parameters, starts, np.array([20.0, 1.0, 20.0]))
    assert result.outcome.tolist() == [ARRIVED, TIMEOUT, ARRIVED]
    ends = [int(np.flatnonzero((poses != poses[-1]).any(-1))[-1]) + 1 for poses in result.poses]
    assert ends[1] == round(1.0 / DT)
    for i in (0, 2):
        assert ends[i] <= round((result.arrival_time[i] + 1.0) / DT) + 1
