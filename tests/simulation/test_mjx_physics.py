"""MJX against MuJoCo C: the same states, stepped once in both."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agile_jax.simulation.physics.mjx_physics import mjx_init, mjx_reset, mjx_step
from agile_jax.simulation.physics.mujoco_physics import MujocoPhysics
from agile_jax.simulation.sensed import contact_flags, touch_slots

STATES = 24


@pytest.fixture(scope="module")
def recorded(model, starts, torque_law):
    """States and torques out of a run in C, four of each episode: (qpos (24, 19), qvel (24, 18), torque (24, 12))."""
    qpos, qvel, torque = [], [], []
    with MujocoPhysics(model, len(starts), 1) as physics:
        sensed = physics.reset(starts)
        for k in range(100):
            torques = torque_law(sensed.qpos, sensed.qvel, k)
            if k % 25 == 24:
                qpos.append(sensed.qpos)
                qvel.append(sensed.qvel)
                torque.append(torques)
            sensed = physics.step(torques)
    return tuple(np.concatenate(values) for values in (qpos, qvel, torque))


@pytest.fixture(scope="module")
def step(model):
    """One compiled step of 24 robots from given states: (qpos, qvel, torque) -> Sensed."""
    device_model = mjx_init(model)

    def one(qpos, qvel, torque):
        data = mjx_reset(device_model, qpos).replace(qvel=qvel)
        return mjx_step(device_model, data, torque)[1]

    # XLA's optimisation costs half of the compilation here and brings nothing to a handful of calls.
    compiled = jax.jit(jax.vmap(one), compiler_options={"xla_backend_optimization_level": 0})
    return lambda *values: jax.device_get(compiled(*(jnp.asarray(value, jnp.float32) for value in values)))


def test_one_step_agrees_with_mujoco_c(model, recorded, step):
    sensed = step(*recorded)
    slots = touch_slots(model)
    flags = []
    for index, (qpos, qvel, torque) in enumerate(zip(*recorded, strict=True)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = np.float32(qpos), np.float32(qvel), np.float32(torque)
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(sensed.qpos[index], data.qpos, atol=1e-4, err_msg=f"{index=}")
        flags.append(contact_flags(data.sensordata, slots)[:2])
        # Where two boxes touch, MJX puts other contact points than C.
        tolerance = 2e-2 if flags[-1][0] else 2e-3
        np.testing.assert_allclose(sensed.qvel[index], data.qvel, atol=tolerance, err_msg=f"{index=}")
    np.testing.assert_array_equal(np.stack([sensed.obstacle_contact, sensed.floor_contact], -1), flags)
    assert np.any(flags, 0).all()
    assert not np.all(flags, 0).any()


def test_a_bad_torque_makes_the_state_bad_for_good(recorded, step):
    qpos, qvel, torque = (value.copy() for value in recorded)
    torque[3, 5] = np.nan
    clean, sensed = step(*recorded), step(qpos, qvel, torque)
    assert not np.isfinite(sensed.qpos[3]).all()
    assert not sensed.obstacle_contact[3]
    others = np.arange(STATES) != 3
    np.testing.assert_array_equal(sensed.qpos[others], clean.qpos[others])
    again = step(sensed.qpos, sensed.qvel, recorded[2])
    assert not np.isfinite(again.qpos[3]).all()


def test_importing_prints_nothing():
    result = subprocess.run(
        [sys.executable, "-c", "import agile_jax.simulation.physics.mjx_physics"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout == ""
    assert result.stderr == ""


@pytest.mark.slow
def test_mujoco_warp_steps_as_mjx(model, starts):
    """On the processor, where MuJoCo Warp is installed."""
    pytest.importorskip("warp", reason="needs mujoco-mjx[warp]")
    ends = []
    for implementation in ("jax", "warp"):
        on_device = mjx_init(model, implementation, len(starts))
        step = jax.jit(jax.vmap(lambda data, torque, on_device=on_device: mjx_step(on_device, data, torque)))
        data = jax.vmap(lambda qpos, on_device=on_device: mjx_reset(on_device, qpos))(jnp.asarray(starts, jnp.float32))
        for _ in range(100):
            data, sensed = step(data, jnp.zeros((len(starts), 12)))
        ends.append(sensed)
    np.testing.assert_allclose(ends[0].qpos, ends[1].qpos, atol=1e-3)
    np.testing.assert_array_equal(ends[0].obstacle_contact, ends[1].obstacle_contact)
    np.testing.assert_array_equal(ends[0].foot_contact, ends[1].foot_contact)
