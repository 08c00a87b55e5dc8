"""Gait clock, swing path and footholds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import GaitSettings, gait
from agile_jax.control.footholds import foothold, within_window
from agile_jax.control.swing import swing_path
from agile_jax.robot import longest_stride

SETTINGS = GaitSettings()
LONG = jnp.float32(10.0)  # a stride that no leg is too short for [m]


def at_phase(phase: float, walk: float = 0.0, stand: bool = False) -> gait.Gait:
    begun = gait.start(SETTINGS)
    now = begun._replace(phase=jnp.float32(phase), walk=jnp.float32(walk), stand=jnp.bool_(stand))
    return now._replace(landed=gait.scheduled(SETTINGS, now))


def schedule_over_a_cycle(walk: float) -> np.ndarray:
    phases = np.linspace(0, 1, 2_000, endpoint=False, dtype=np.float32)
    return np.array(jax.vmap(lambda phase: gait.scheduled(SETTINGS, at_phase(0.0, walk)._replace(phase=phase)))(phases))


def test_trot_moves_diagonal_legs_together_and_stands_for_its_duty():
    stands = schedule_over_a_cycle(0.0)
    np.testing.assert_array_equal(stands[:, 0], stands[:, 3])
    np.testing.assert_array_equal(stands[:, 1], stands[:, 2])
    np.testing.assert_allclose(stands.mean(0), SETTINGS.duty, atol=2e-3)
    assert stands.any(-1).all()  # duty above one half: never all feet in the air


def test_walk_lifts_one_foot_at_a_time_each_side_from_behind():
    stands = schedule_over_a_cycle(1.0)
    np.testing.assert_allclose(stands.mean(0), SETTINGS.walk_duty, atol=2e-3)
    assert (stands.sum(-1) >= 3).all()
    lifts = {leg: np.flatnonzero(np.diff(stands[:, leg].astype(int)) == -1)[0] for leg in range(4)}
    order = sorted(lifts, key=lifts.__getitem__)
    first = order.index(2)
    assert order[first:] + order[:first] == [2, 0, 3, 1]  # RR, FR, RL, FL


@pytest.mark.parametrize("walk", [0.0, 1.0])
def test_standing_stops_with_all_feet_down_and_goes_on_from_there(walk: float):
    now = at_phase(0.2, walk, stand=True)
    ahead = np.array(gait.contacts_ahead(SETTINGS, now, jnp.linspace(0.0, 1.0, 50)))
    assert not ahead.all()  # a swing is finished first
    for _ in range(300):
        now = gait.advance(SETTINGS, now, 0.002, None)
    assert now.phase in (0.0, 0.5)
    assert gait.scheduled(SETTINGS, now).all()
    assert np.array(gait.contacts_ahead(SETTINGS, now, jnp.linspace(0.0, 1.0, 50))).all()
    again = gait.advance(SETTINGS, now._replace(stand=jnp.bool_(False)), 0.002, None)
    assert 0 < again.phase - now.phase < 0.01


def test_early_contact_makes_a_foot_stand_only_late_in_its_swing():
    touching = jnp.array([False, True, True, False])
    begins = at_phase(0.1)  # FL and RR swing: progress 0.11
    assert not gait.advance(SETTINGS, begins, 0.002, touching).landed[1]
    ends = at_phase(0.4)  # progress 0.78
    landed = gait.advance(SETTINGS, ends, 0.002, touching)
    assert landed.landed.all()
    # It stays so without touching, and the MPC counts on it until its stance is over.
    later = gait.advance(SETTINGS, landed, 0.002, jnp.zeros(4, bool))
    assert later.landed.all()
    assert gait.contacts_ahead(SETTINGS, later, jnp.array([0.0, 0.02]))[:, 1].all()


def test_a_foot_that_misses_the_ground_reaches_further_and_bears_nothing():
    missing = at_phase(0.3)._replace(landed=jnp.array([False, False, False, True]))  # FR is missing
    late = np.array(gait.late_by(SETTINGS, missing))
    assert late[0] == pytest.approx(0.3 * SETTINGS.period, abs=1e-6)
    assert not late[1:].any()
    assert gait.swing_progress(SETTINGS, missing)[0] == 1.0
    contacts = gait.contacts_ahead(SETTINGS, missing, jnp.array([0.0, 0.03]))
    assert not contacts[0, 0]
    assert contacts[1, 0]


def test_walk_and_trot_blend_and_periods_follow_the_speed():
    settings = GaitSettings(walk_speed=0.3, slow_period=0.4)
    moving = gait.start(settings)
    for _ in range(60):
        moving = gait.schedule(settings, moving, jnp.float32(0.6), LONG, jnp.bool_(False), 0.02)
    assert moving.walk == 0.0
    assert moving.period == pytest.approx(settings.period)
    slower = gait.schedule(settings, moving, jnp.float32(0.25), LONG, jnp.bool_(False), 0.02)
    assert slower.walk == pytest.approx(0.02)
    assert gait.step_height(settings, jnp.float32(0.0), jnp.float32(1.0), 0.01) == pytest.approx(
        settings.slow_step_height
    )


def test_swing_path_starts_and_ends_at_rest_and_reaches_its_apex():
    lift_off, touch_down = jnp.array([0.1, -0.1, 0.02]), jnp.array([0.25, -0.12, 0.03])
    height, duration = jnp.float32(0.05), 0.16

    def path(progress):
        return swing_path(lift_off, touch_down, height, progress, duration)

    for progress, expected in ((0.0, lift_off), (1.0, touch_down)):
        position, velocity, _ = path(jnp.float32(progress))
        np.testing.assert_allclose(position, expected, atol=1e-6)
        np.testing.assert_allclose(velocity, 0, atol=1e-5)
    assert np.isclose(path(jnp.float32(0.5))[0][2], 0.03 + 0.05)


def test_swing_velocity_and_acceleration_are_derivatives():
    lift_off, touch_down = jnp.array([0.1, -0.1, 0.02]), jnp.array([0.25, -0.12, 0.03])
    duration = 0.16

    def position(progress):
        return swing_path(lift_off, touch_down, jnp.float32(0.05), progress, duration)[0]

    for progress in (0.1, 0.4, 0.6, 0.9):
        rate = jax.jacfwd(position)
        _, velocity, acceleration = swing_path(lift_off, touch_down, jnp.float32(0.05), jnp.float32(progress), duration)
        np.testing.assert_allclose(velocity, rate(jnp.float32(progress)) / duration, atol=1e-5)
        np.testing.assert_allclose(acceleration, jax.jacfwd(rate)(jnp.float32(progress)) / duration**2, atol=1e-3)


def test_foothold_is_symmetric_and_catches_a_push():
    hips = jnp.zeros((4, 2))
    still = jnp.zeros(2)
    height = jnp.float32(0.27)
    np.testing.assert_allclose(foothold(hips, still, still, jnp.float32(0), height, 0.2, 0.03), 0)
    # At the wanted velocity the foot lands half a stance ahead; pushed, further in the push's direction.
    v = jnp.array([0.5, 0.0])
    np.testing.assert_allclose(foothold(hips, v, v, jnp.float32(0), height, 0.2, 0.03)[0], [0.05, 0], atol=1e-6)
    pushed = foothold(hips, jnp.array([0.0, 0.4]), still, jnp.float32(0), height, 0.2, 0.03)
    np.testing.assert_allclose(pushed[0], [0, 0.04 + 0.012], atol=1e-6)
    # Turning left at speed, the feet land to the right: v x w.
    assert foothold(hips, v, v, jnp.float32(1), height, 0.2, 0.03)[0, 1] < 0


def test_strides_that_fit_stay_within_the_window():
    """Places of a foot over whole strides, from its hip, by the swing path itself: none leaves the window."""
    rear, front, stands = np.array(-0.08), np.array(0.05), 0.55
    longest = float(longest_stride(rear, front, stands))
    window = jnp.asarray([rear, front], jnp.float32)
    s = np.linspace(0, 1, 400, dtype=np.float32)
    for stride in np.array([0.2, 0.7, 0.999, -0.5, -0.999]) * longest:
        for wanted in (-0.3, 0.0, stride * stands / 2, 0.3):
            landing = float(within_window(jnp.full(4, wanted), jnp.float32(stride), jnp.float32(stands), window)[0])
            off = landing - stands * stride
            ends = (
                jnp.tile(jnp.array([[off, 0, 0.02]]), (len(s), 1)),
                jnp.tile(jnp.array([[off + stride, 0, 0.02]]), (len(s), 1)),
            )
            position, _, _ = swing_path(*ends, jnp.full(len(s), 0.02), jnp.asarray(s), 0.1)
            seen = np.concatenate([np.asarray(position)[:, 0] - stride * (1 - stands) * s, [landing, off]])
            assert rear - 1e-5 <= seen.min()
            assert seen.max() <= front + 1e-5
            if wanted == 0.0 and abs(stride) < 0.3 * longest:  # nothing binds
                assert landing == pytest.approx(wanted, abs=1e-6)


def test_a_stride_too_long_leaves_the_window_on_both_sides_alike():
    window = jnp.array([-0.08, 0.05], jnp.float32)
    landing = within_window(jnp.full(4, 0.2), jnp.float32(0.4), jnp.float32(0.55), window)[0]
    assert float(landing + landing - 0.55 * 0.4) == pytest.approx(-0.08 + 0.05, abs=1e-6)


def test_the_trot_quickens_where_the_legs_allow_no_longer_stride():
    """Continuous in height and speed, never slower than asked and never quicker than the legs can swing."""
    trot = gait.start(SETTINGS)

    def period(speed: float, longest: float) -> float:
        return float(
            gait.schedule(SETTINGS, trot, jnp.float32(speed), jnp.float32(longest), jnp.bool_(False), 0.02).period
        )

    trot = trot._replace(walk=jnp.float32(0.0))
    assert period(1.0, 0.5) == pytest.approx(SETTINGS.period)
    assert period(1.0, 0.24) == pytest.approx(0.24)
    assert period(2.0, 0.24) == pytest.approx(SETTINGS.shortest_period)
    periods = np.array([[period(v, stride) for v in np.linspace(0, 1.5, 60)] for stride in np.linspace(0.1, 0.4, 30)])
    assert np.abs(np.diff(periods, axis=0)).max() < 0.03
    assert np.abs(np.diff(periods, axis=1)).max() < 0.03
    assert (np.diff(periods, axis=0) >= -1e-6).all()
    assert (np.diff(periods, axis=1) <= 1e-6).all()
