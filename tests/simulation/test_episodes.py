"""Closed-loop episodes whose outcome is known beforehand, in both backends."""

from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import ControlSettings, make_controller
from agile_jax.robot import RobotSettings, build_mujoco_model, collision_shapes, load_robot, standing_qpos
from agile_jax.scene import Scene, SceneSettings, make_scene
from agile_jax.simulation import (
    OUTCOME_NAMES,
    ClosedLoop,
    LastStates,
    MjxSlots,
    MujocoPhysics,
    MujocoSlots,
    Recorder,
    Rollout,
    Trace,
    batch_loop,
    gather,
    mjx_init,
    mjx_loop,
    policy_guidance,
    stream,
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
    model = build_mujoco_model(scene(), RobotSettings(), CONTROL.control_dt)
    guidance, controller = policy_guidance(straight_line), make_controller(ROBOT, CONTROL)
    loop = ClosedLoop(scene(), ROBOT, collision_shapes(model), CONTROL, guidance, ACCELERATION, controller)
    return loop, batch_loop(loop), model


def standing(starts: np.ndarray) -> np.ndarray:
    return np.stack([standing_qpos(ROBOT, np.asarray(start, float)) for start in starts])


def run(
    starts: np.ndarray, limits: np.ndarray, threads: int = 2, slots: int = 4, traced: int = 0
) -> tuple[Rollout, list[Trace]]:
    _, compiled, model = parts()
    with MujocoPhysics(model, slots, threads) as physics:
        running = MujocoSlots(compiled, physics, jnp.float32(1.0))
        recorder = Recorder(running, traced)
        rollout = gather(len(starts), stream(running, standing(starts), limits, recorder))
    return rollout, recorder.traces(scene(), CONTROL.plan_dt)


def assert_same(one: Rollout, other: Rollout) -> None:
    for name, values in one.outcome._asdict().items():
        np.testing.assert_array_equal(getattr(other.outcome, name), values, err_msg=name)
    np.testing.assert_array_equal(one.plans, other.plans)


def names(rollout: Rollout) -> list[str]:
    return [OUTCOME_NAMES[int(code)] for code in rollout.outcome.status]


@pytest.fixture(scope="module")
def recorded() -> tuple[Rollout, list[Trace]]:
    return run(STARTS, LIMITS, traced=4)


@pytest.fixture(scope="module")
def reference(recorded: tuple[Rollout, list[Trace]]) -> Rollout:
    return recorded[0]


def test_each_outcome_is_recognised(reference: Rollout):
    assert names(reference) == EXPECTED


def test_success_takes_as_long_as_the_way_and_the_stay(reference: Rollout):
    # 0.3 m to the edge of the tolerance at up to 0.8 m/s and 1.5 m/s^2: at least 0.63 s; then the stay of 0.5 s.
    arrival = float(reference.outcome.inside_since[0])
    assert 0.5 < arrival < 2.0
    assert reference.outcome.time[0] == pytest.approx(arrival + 0.5, abs=0.003)


def test_timeout_ends_at_the_limit(reference: Rollout):
    assert reference.outcome.time[2] == pytest.approx(0.2, abs=0.003)


def test_traces_end_with_their_episodes_and_hold_what_was_simulated(recorded: tuple[Rollout, list[Trace]]):
    rollout, traces = recorded
    for episode, trace in enumerate(traces[:3]):
        assert trace.time[-1] == pytest.approx(float(rollout.outcome.time[episode]), abs=0.021)
        assert trace.qpos.shape == (len(trace.time), 19)
        assert np.abs(trace.torque).max() <= 33.5 + 1e-4
    collided = traces[1]
    assert collided.clearance[-1] < 0.1 < collided.clearance[0]


def test_the_last_states_of_an_unstable_episode_are_kept():
    """Ten plans, then a NaN command, in a slot that held another episode before."""
    _, compiled, model = parts()
    with MujocoPhysics(model, 1, 1) as physics:
        running = MujocoSlots(compiled, physics, jnp.float32(1.0))
        last = LastStates(running, plans=5)
        gather(2, stream(running, standing(STARTS[2:]), LIMITS[2:], last))
        trace = last.trace(1, 0.5, scene(), CONTROL.plan_dt)
    assert trace.time[-1] == 0.5
    assert 1 <= len(trace.time) <= 5
    assert np.isfinite(trace.qpos[:-1]).all()
    assert not np.isfinite(trace.qpos[-1]).all()


def test_a_robot_that_begins_below_the_floor_fails_and_its_neighbours_do_not(reference: Rollout):
    """Its feet 10 cm deep: the contacts throw it out, whatever follows it is no success."""
    starts = STARTS[[0, 2]].copy()
    starts[0, 2] = 0.05
    rollout, _ = run(starts, LIMITS[[0, 2]])
    assert names(rollout)[0] in ("fall", "unstable", "timeout")
    assert_same(Rollout(*_select(reference, np.array([2]))), Rollout(*_select(rollout, np.array([1]))))


def test_results_do_not_depend_on_threads_or_slots(reference: Rollout):
    # More episodes than slots: each of the four appears three times, each time beside other neighbours.
    order = np.array([3, 0, 1, 2, 2, 1, 0, 3, 0, 2, 3, 1])
    rollout, _ = run(STARTS[order], LIMITS[order], threads=1)
    assert_same(Rollout(*_select(reference, order)), rollout)


def _select(rollout: Rollout, order: np.ndarray) -> tuple[Any, ...]:
    outcome = type(rollout.outcome)(*(values[order] for values in rollout.outcome))
    return outcome, rollout.counts.mpc_failures[order], rollout.plans[order]


@pytest.fixture(scope="module")
def in_mjx() -> tuple[Rollout, list[Trace]]:
    """Through two slots: two of the four begin when others have ended."""
    loop, _, model = parts()
    slots = MjxSlots(mjx_loop(loop, mjx_init(model)), 2, jnp.float32(1.0))
    recorder = Recorder(slots, 2)
    rollout = gather(len(STARTS), stream(slots, standing(STARTS), LIMITS, recorder))
    return rollout, recorder.traces(scene(), CONTROL.plan_dt)


def test_mjx_and_mujoco_agree_on_the_outcomes(reference: Rollout, in_mjx: tuple[Rollout, list[Trace]]):
    rollout, _ = in_mjx
    assert names(rollout) == names(reference)
    np.testing.assert_allclose(rollout.outcome.time[:3], reference.outcome.time[:3], atol=0.1)
    assert rollout.outcome.planar_error[0] == pytest.approx(float(reference.outcome.planar_error[0]), abs=0.03)


def test_mjx_records_the_traces_that_mujoco_does(
    recorded: tuple[Rollout, list[Trace]], in_mjx: tuple[Rollout, list[Trace]]
):
    for trace, other in zip(recorded[1][:2], in_mjx[1], strict=True):
        count = min(len(trace.time), len(other.time), 10)  # they part later: contacts amplify rounding
        np.testing.assert_allclose(other.qpos[:count, :3], trace.qpos[:count, :3], atol=5e-3)
        assert other.time[-1] == pytest.approx(trace.time[-1], abs=0.1)
