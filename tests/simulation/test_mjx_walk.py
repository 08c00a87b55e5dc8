"""MJX against MuJoCo C along a walk: 1,000 single steps, and 0.2 s under the same torques."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from agile_jax.benchmark.workloads.commands import random_commands
from agile_jax.benchmark.workloads.disturbance import draw
from agile_jax.benchmark.workloads.tracking import UNDISTURBED, tracking_loop
from agile_jax.control import ControlSettings, make_controller
from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot, standing_qpos
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import MujocoPhysics
from agile_jax.simulation.physics.mjx_physics import mjx_init, mjx_reset, mjx_step
from agile_jax.simulation.plan_cycle import on_host, plan_cycle
from agile_jax.single_precision import as_float32

pytestmark = pytest.mark.slow

ROBOTS, PLANS, SECONDS = 25, 60, 0.2
CONTROL, ROBOT = ControlSettings(), RobotSettings()
MODEL = build_mujoco_model(make_scene(SceneSettings()), ROBOT, CONTROL.control_dt)


@pytest.fixture(scope="module")
def walk():
    """States and torques of 25 robots over 1.2 s: qpos (K, 25, 19), qvel (K, 25, 18), torque (K, 25, 12)."""
    robot = load_robot(ROBOT)
    loop = tracking_loop(robot, CONTROL, UNDISTURBED, make_controller(robot, CONTROL))
    commands = as_float32(random_commands(ROBOTS, 0, (0.2, 1.0), 0.4, 0.8, 0.28))
    start = np.asarray(standing_qpos(robot, np.array([0.0, 0.0, 0.28, 0.0], np.float32)))
    recorded = []
    with MujocoPhysics(MODEL, ROBOTS, 2) as physics:

        def step(before, states):
            torque = np.float32(states.torque)
            recorded.append((np.float32(before.qpos), np.float32(before.qvel), torque))
            sensed = physics.step(torque.astype(float))
            return sensed, sensed

        sensed = physics.reset(np.repeat(start[None], ROBOTS, 0))
        states = loop.init(sensed, commands, draw(ROBOTS, 0))
        for _ in range(PLANS):
            _, states, sensed = plan_cycle(
                loop.plan, loop.act, step, sensed, states, sensed, loop.acts_per_plan, on_host
            )
    return tuple(np.stack(values) for values in zip(*recorded, strict=True))


def in_c(qpos, qvel, torques):
    """State after the torques (k, 12), shape (37,)."""
    data = mujoco.MjData(MODEL)
    data.qpos[:], data.qvel[:] = qpos, qvel
    for torque in torques:
        data.ctrl[:] = torque
        mujoco.mj_step(MODEL, data)
    return np.concatenate([data.qpos, data.qvel]), data.ncon


@pytest.fixture(scope="module")
def in_mjx():
    """States (n, 37) after torques (n, k, 12), in blocks of 50 robots; compiled once a k."""
    on_device = mjx_init(MODEL)

    @jax.jit
    @jax.vmap
    def run(qpos, qvel, torques):
        data = mjx_reset(on_device, qpos).replace(qvel=qvel)
        data, _ = jax.lax.scan(lambda data, torque: (mjx_step(on_device, data, torque)[0], None), data, torques)
        return jnp.concatenate([data.qpos, data.qvel])

    def blocks(*values):
        parts = [run(*(value[i : i + 50] for value in values)) for i in range(0, len(values[0]), 50)]
        return np.concatenate([np.asarray(part) for part in parts])

    return blocks


def test_a_thousand_single_steps(walk, in_mjx):
    steps = np.linspace(150, len(walk[0]) - 1, 40).astype(int)
    qpos, qvel, torque = (values[steps].reshape(1000, -1) for values in walk)
    there = in_mjx(qpos, qvel, torque[:, None])
    here, contacts = zip(*map(in_c, qpos, qvel, torque[:, None]), strict=True)
    difference = np.abs(there - np.array(here))
    print(f"contacts: {np.mean(contacts):.2f} a state")
    print(f"positions: largest {difference[:, :19].max():.1e}, velocities: largest {difference[:, 19:].max():.1e}")
    assert np.mean(np.array(contacts) >= 2) > 0.9
    assert difference[:, :19].max() < 1e-4
    assert difference[:, 19:].max() < 5e-3


def test_a_fifth_of_a_second_under_the_same_torques(walk, in_mjx):
    count = round(SECONDS / CONTROL.control_dt)
    begins = np.array([200, 300, 400, 490])
    qpos, qvel = (values[begins].reshape(100, -1) for values in walk[:2])
    torques = np.stack([walk[2][k : k + count] for k in begins]).transpose(0, 2, 1, 3).reshape(100, count, 12)
    there = in_mjx(qpos, qvel, torques)
    here = np.array([in_c(*one)[0] for one in zip(qpos, qvel, torques, strict=True)])
    apart = np.linalg.norm((there - here)[:, :3], axis=1)
    print(f"trunks apart after {SECONDS} s: median {1e3 * np.median(apart):.2f} mm, largest {1e3 * apart.max():.2f} mm")
    assert apart.max() < 5e-3
