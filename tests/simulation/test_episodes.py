"""Closed-loop episodes whose outcome is known beforehand, in both backends."""

from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import ControlSettings
from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot, standing_qpos
from agile_jax.scene import Scene, SceneSettings, make_scene
from agile_jax.simulation import (
    OUTCOME_NAMES,
    MujocoPhysics,
    Rollout,
    batch_loop,
    make_closed_loop,
    mjx_init,
    mjx_runner,
    run_mujoco,
)

CONTROL = ControlSettings()
ROBOT = load_robot(RobotSettings())
ACCELERATION = np.array([1.5, 1.5, 1.0, 3.0])
SCENE = SceneSettings.model_validate(
    {
        "target": [1.0, 0.0, 0.28, 0.0],
        "obstacles": [{"kind": "box", "position": [0.4, 2.0, 0.2], "size": [0.2, 0.6, 0.4]}],
    }
)
# Free way; a box in the way; too little time; a command that is not a number.
STARTS = np.array([[0.6, 0.0, 0.27, 0.0], [-0.4, 2.0, 0.27, 0.0], [0.0, 0.0, 0.27, 0.0], [0.5, -1.0, 0.27, 0.0]])
LIMITS = np.array([4.0, 4.0, 0.2, 4.0])
EXPECTED = ["success", "collision", "timeout", "unstable"]


def straight_line(parameters: Any, pose: jnp.ndarray, velocity: jnp.ndarray, dt: float) -> jnp.ndarray:
    """Drive straight to x = 1 at up to 0.8 m/s, keeping y: blind to obstacles, NaN at y < -0.5."""
    pose = pose + velocity * dt
    error = jnp.stack([1.0 - pose[0], 0.0, 0.28 - pose[2], -pose[3]])
    speed = jnp.clip(2.0 * error, -0.8, 0.8)
    return jnp.where(pose[1] < -0.5, jnp.nan, parameters) * speed


@lru_cache
def scene() -> Scene:
    return make_scene(SCENE)


@lru_cache
def parts() -> tuple[Any, Any, Any]:
    loop = make_closed_loop(scene(), ROBOT, CONTROL, straight_line, ACCELERATION)
    return loop, batch_loop(loop), build_mujoco_model(scene(), RobotSettings(), CONTROL.control_dt)


def run(starts: np.ndarray, limits: np.ndarray, threads: int = 2, traced: int = 0) -> Rollout:
    _, compiled, model = parts()
    qpos = np.stack([standing_qpos(ROBOT, start) for start in starts])
    with MujocoPhysics(model, len(starts), threads) as physics:
        return run_mujoco(compiled, physics, jnp.float32(1.0), qpos, limits, scene(), traced)


def names(rollout: Rollout) -> list[str]:
    return [OUTCOME_NAMES[int(code)] for code in rollout.outcome.status]


@pytest.fixture(scope="module")
def reference() -> Rollout:
    return run(STARTS, LIMITS, traced=4)


def test_each_outcome_is_recognised(reference: Rollout):
    assert names(reference) == EXPECTED


def test_success_takes_as_long_as_the_way_and_the_stay(reference: Rollout):
    # 0.3 m to the edge of the tolerance at up to 0.8 m/s and 1.5 m/s^2: at least 0.63 s; then the stay of 0.5 s.
    arrival = float(reference.outcome.inside_since[0])
    assert 0.5 < arrival < 2.0
    assert reference.outcome.time[0] == pytest.approx(arrival + 0.5, abs=0.003)


def test_timeout_ends_at_the_limit(reference: Rollout):
    assert reference.outcome.time[2] == pytest.approx(0.2, abs=0.003)


def test_traces_end_with_their_episodes_and_hold_what_was_simulated(reference: Rollout):
    for episode, trace in enumerate(reference.traces[:3]):
        assert trace.time[-1] == pytest.approx(float(reference.outcome.time[episode]), abs=0.021)
        assert trace.qpos.shape == (len(trace.time), 19)
        assert np.abs(trace.torque).max() <= 33.5 + 1e-4
    collided = reference.traces[1]
    assert collided.clearance[-1] < 0.1 < collided.clearance[0]


def test_results_do_not_depend_on_threads(reference: Rollout):
    other = run(STARTS, LIMITS, threads=1)
    for name, values in reference.outcome._asdict().items():
        np.testing.assert_array_equal(getattr(other.outcome, name), values, err_msg=name)


def test_mjx_and_mujoco_agree_on_the_outcomes(reference: Rollout):
    loop, _, model = parts()
    qpos = np.stack([standing_qpos(ROBOT, start) for start in STARTS])
    rollout = mjx_runner(loop, mjx_init(model))(jnp.float32(1.0), qpos, LIMITS)
    assert names(rollout) == names(reference)
    np.testing.assert_allclose(rollout.outcome.time[:3], reference.outcome.time[:3], atol=0.1)
    assert rollout.outcome.planar_error[0] == pytest.approx(float(reference.outcome.planar_error[0]), abs=0.03)
