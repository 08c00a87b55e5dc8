"""The threaded physics against a plain loop, and the independence of episodes."""

import mujoco
import numpy as np
import pytest

from agile_jax.settings import BadInput
from agile_jax.simulation.physics.mujoco_physics import MujocoPhysics


def run(model, starts, law, steps, threads=1):
    """States (steps, n, 37) and flags (steps, n, 2) of a closed loop."""
    states, flags = [], []
    with MujocoPhysics(model, len(starts), threads) as physics:
        sensed = physics.reset(starts)
        for k in range(steps):
            sensed = physics.step(law(sensed.qpos, sensed.qvel, k))
            states.append(np.concatenate([sensed.qpos, sensed.qvel], -1))
            flags.append(np.stack([sensed.obstacle_contact, sensed.floor_contact], -1))
    return np.array(states), np.array(flags)


@pytest.fixture(scope="module")
def reference(model, starts, torque_law):
    return run(model, starts, torque_law, 150)


def test_equals_a_plain_loop(model, starts, torque_law, reference):
    """Up to the first contact with the table, where an episode ends and the solver may stop short of convergence."""
    states, flags = reference
    compared = 0
    for episode, start in enumerate(starts):
        data = mujoco.MjData(model)
        data.qpos[:] = start
        for k in range(60):
            data.ctrl[:] = torque_law(data.qpos[None], data.qvel[None], k)[0]
            mujoco.mj_step(model, data)
            if flags[k, episode, 0]:
                break
            np.testing.assert_allclose(states[k, episode, :19], data.qpos, atol=1e-9, err_msg=f"{episode=} {k=}")
            np.testing.assert_allclose(states[k, episode, 19:], data.qvel, atol=1e-7, err_msg=f"{episode=} {k=}")
            compared += 1
    assert compared > 150


def test_threads_and_neighbours_do_not_matter(model, starts, torque_law, reference):
    states, flags = reference
    threaded = run(model, starts, torque_law, 150, threads=3)
    np.testing.assert_array_equal(threaded[0], states)
    np.testing.assert_array_equal(threaded[1], flags)
    order = [4, 1, 5]
    reordered = run(model, starts[order], torque_law, 150, threads=2)
    np.testing.assert_array_equal(reordered[0], states[:, order])
    alone = run(model, starts[3:4], torque_law, 150)
    np.testing.assert_array_equal(alone[0], states[:, 3:4])


def test_flags(reference):
    obstacle, floor = np.moveaxis(reference[1].any(0), -1, 0)
    np.testing.assert_array_equal(reference[1][0, :, 0], [False, False, False, False, True, False])
    np.testing.assert_array_equal(
        obstacle, [False, False, True, True, True, False]
    )  # the third stands up under the table
    assert floor[5]  # fell on its side
    assert not floor[:3].any()


def test_paused_episodes_are_frozen_and_go_on_unchanged(model, starts, torque_law, reference):
    states, flags = reference
    active = np.array([True, False, True, False, True, True])
    with MujocoPhysics(model, len(starts), 2) as physics:
        sensed = physics.reset(starts)
        for k in range(30):
            sensed = physics.step(torque_law(sensed.qpos, sensed.qvel, k))
        for k in range(30, 60):
            sensed = physics.step(torque_law(sensed.qpos, sensed.qvel, k), active)
        np.testing.assert_array_equal(sensed.qpos[active], states[59, active, :19])
        np.testing.assert_array_equal(sensed.qpos[~active], states[29, ~active, :19])
        np.testing.assert_array_equal(sensed.obstacle_contact[~active], flags[29, ~active, 0])
        for k in range(30, 60):
            sensed = physics.step(torque_law(sensed.qpos, sensed.qvel, k), ~active)
        np.testing.assert_array_equal(sensed.qpos, states[59, :, :19])
        np.testing.assert_array_equal(sensed.qvel, states[59, :, 19:])


def test_nan_torque_makes_the_state_nan_and_leaves_the_others_alone(
    model, starts, torque_law, reference, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with MujocoPhysics(model, len(starts), 2) as physics:
        sensed = physics.reset(starts)
        for k in range(20):
            torques = torque_law(sensed.qpos, sensed.qvel, k)
            if k == 10:
                torques[2, 5] = np.nan
                torques[3, 0] = np.inf
            sensed = physics.step(torques)
        others = [0, 1, 4, 5]
        np.testing.assert_array_equal(sensed.qpos[others], reference[0][19, others, :19])
        assert np.isnan(sensed.qpos[2:4]).all()
        assert np.isnan(sensed.qvel[2:4]).all()
        assert not sensed.obstacle_contact[2:4].any()
        sensed = physics.reset(starts)
        assert np.isfinite(sensed.qpos).all()
        sensed = physics.step(torque_law(sensed.qpos, sensed.qvel, 0))
        np.testing.assert_array_equal(sensed.qpos, reference[0][0, :, :19])
    assert not list(tmp_path.iterdir())  # MuJoCo leaves a log file where it met a bad number


def test_an_absurd_velocity_ends_as_nan_not_as_a_fresh_episode(model, starts):
    with MujocoPhysics(model, 6, 1) as physics:
        physics.reset(starts)
        physics._qvel[1, 0] = 1e20
        sensed = physics.step(np.zeros((6, 12)))
        assert np.isnan(sensed.qpos[1]).all()
        assert np.isfinite(sensed.qpos[[0, 2, 3, 4, 5]]).all()


def test_threads_must_be_positive(model):
    with pytest.raises(BadInput, match="threads = 0"):
        MujocoPhysics(model, 2, 0)
