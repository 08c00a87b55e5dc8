"""The reference that drives along a field: its limits, its path, its lead."""

from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import ControlSettings
from agile_jax.policy.velocity_tracker import track
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation.paths import TimedPath, path_guidance
from agile_jax.simulation.reference import ReferenceState, drive, limit_lead, plan_reference, slowed

SETTINGS = ControlSettings()
LIMIT = jnp.array([1.5, 1.5, 1.0, 3.0])
TARGET = jnp.array([1.0, 0.5, 0.28, 0.0])


def towards_target(rate):
    return lambda pose, velocity, time, dt: rate * (TARGET - pose - velocity * dt)


def test_acceleration_stays_within_its_limits():
    rng = np.random.default_rng(0)
    for _ in range(200):
        wanted, velocity = rng.normal(size=(2, 4))
        change = np.array(track(jnp.asarray(wanted), jnp.asarray(velocity), LIMIT, 0.02)) - velocity
        assert (np.abs(change) <= np.array(LIMIT) * 0.02 + 1e-6).all()


def test_from_rest_the_velocity_has_the_fields_direction():
    wanted = jnp.array([1.0, -0.2, -0.3, 0.1])
    velocity = jnp.zeros(4)
    for _ in range(10):
        velocity = track(wanted, velocity, LIMIT, 0.02)
        np.testing.assert_allclose(velocity / velocity[0], wanted / wanted[0], rtol=1e-4)


def test_a_cruising_robot_brakes_one_axis_at_its_full_limit():
    """Speed ahead must not slow down the end of a descent."""
    velocity = track(jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.array([1.0, 0.0, -0.3, 0.0]), LIMIT, 0.02)
    np.testing.assert_allclose(velocity, [1.0, 0.0, -0.28, 0.0], atol=1e-6)


def test_reached_velocity_is_kept():
    wanted = jnp.array([0.5, 0.1, 0.0, 0.0])
    np.testing.assert_allclose(track(wanted, wanted, LIMIT, 0.02), wanted, atol=1e-7)


def test_driving_along_a_linear_field_decays_exponentially():
    state = ReferenceState(TARGET + jnp.array([0.05, 0.0, 0.02, 0.0]), jnp.zeros(4))
    for _ in range(200):
        state = drive(towards_target(2.0), state, jnp.float32(0.0), LIMIT, 0.02)
    np.testing.assert_allclose(state.pose, TARGET, atol=1e-3)


def test_the_lead_limit_pulls_back_only_what_leads_too_far_and_wraps_yaw():
    pose = jnp.array([1.0, 2.0, 0.2, 3.1])
    near = ReferenceState(pose + jnp.array([0.01, -0.02, 0.01, 0.05]), jnp.ones(4))
    np.testing.assert_allclose(limit_lead(near, pose, SETTINGS).pose[:3], near.pose[:3], atol=1e-5)
    far = ReferenceState(pose + jnp.array([3.0, 4.0, 0.5, 0.0]), jnp.ones(4))
    held = limit_lead(far, pose, SETTINGS).pose - pose
    np.testing.assert_allclose(
        held[:3], [0.6 * SETTINGS.lead_limit[0], 0.8 * SETTINGS.lead_limit[0], SETTINGS.lead_limit[1]], rtol=1e-3
    )
    # A reference at -3.1 rad is 0.08 rad ahead of a robot at +3.1 rad, not 6.2 behind.
    turned = ReferenceState(pose.at[3].set(-3.1), jnp.ones(4))
    assert limit_lead(turned, pose, SETTINGS).pose[3] - 3.1 == pytest.approx(2 * np.pi - 6.2, abs=1e-4)


def test_a_slowed_reference_is_no_faster_than_the_legs_allow_at_its_height():
    """It comes down while it runs, as fast as it may slow down, and it is faster again when it has come up."""
    crouch = {"by": "hand", "lowest": 0.12, "heights": (0.12, 0.16), "speeds": (0.5, 1.1)}
    scene = make_scene(SceneSettings(crouch=crouch))

    def straight_on(parameters, path, pose, velocity, time, dt):
        height = jnp.where(time < 3.0, 0.13, 0.28)
        return jnp.stack([1.0, 0.4, jnp.clip(5 * (height - pose[2]), -0.08, 0.08), 0.0])

    guide = partial(slowed(straight_on, scene), None, None)
    state, states = ReferenceState(jnp.array([0.0, 0.0, 0.2, 0.0]), jnp.zeros(4)), []
    for k in range(300):
        state = drive(guide, state, jnp.float32(0.02 * k), LIMIT, 0.02)
        states.append(np.concatenate(state))
    poses, velocities = np.split(np.array(states), 2, axis=1)
    allowed = 0.5 + (poses[:, 2] - 0.12) * 15
    assert (velocities[:, 0] <= allowed + 0.03 + 1e-6).all()  # a step of slowing down
    crawling = slice(120, 150)
    np.testing.assert_allclose(velocities[crawling, 0], 0.65, atol=0.02)
    np.testing.assert_allclose(velocities[crawling, 1], 0.65 * 0.4, atol=0.02)  # in the same direction
    assert velocities[-1, 0] == pytest.approx(1.0, abs=1e-6)


def test_horizon_continues_the_state_that_is_kept():
    state = ReferenceState(jnp.array([0.0, 0.0, 0.28, 0.0]), jnp.zeros(4))
    kept, reference = plan_reference(towards_target(1.0), state, state.pose, jnp.float32(0.0), LIMIT, SETTINGS)
    np.testing.assert_array_equal(reference.pose, kept.pose)
    assert reference.poses.shape == (SETTINGS.mpc.horizon, 4)
    first = drive(towards_target(1.0), kept, jnp.float32(0.02), LIMIT, SETTINGS.mpc.mpc_dt)
    np.testing.assert_allclose(reference.poses[0], first.pose, atol=1e-6)
    assert (np.diff(np.array(reference.poses[:, 0])) > 0).all()


def test_a_reference_that_follows_a_path_stays_on_it():
    """A path within the acceleration limits: half a turn of a circle of radius 0.5 m in 3 s, from and to rest."""
    times = jnp.linspace(0.0, 3.0, 151)
    share = times / 3.0
    angle = jnp.pi * (3 * share**2 - 2 * share**3)
    poses = jnp.stack([0.5 - 0.5 * jnp.cos(angle), 0.5 * jnp.sin(angle), 0.28 + 0 * angle, 0 * angle], -1)
    path = TimedPath(times, poses, jnp.gradient(poses, times, axis=0), jnp.float32(0.5))
    limit = jnp.array([3.0, 3.0, 1.0, 3.0])
    state = ReferenceState(poses[0], jnp.zeros(4))
    worst = 0.0
    for k in range(200):
        time = 0.02 * k
        state = drive(partial(path_guidance, None, path), state, jnp.float32(time), limit, 0.02)
        expected = [float(jnp.interp(time + 0.02 - 0.5, times, poses[:, i])) for i in range(4)]
        worst = max(worst, float(jnp.abs(state.pose - jnp.array(expected)).max()))
    assert worst < 0.02
    np.testing.assert_allclose(state.pose, poses[-1], atol=5e-3)
