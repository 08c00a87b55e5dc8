"""The closed loop takes its controller as an argument: one of three lines of control law, in C MuJoCo and in MJX."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agile_jax.control import Controller, ControlSettings, Diagnostics, Reference, no_diagnostics
from agile_jax.robot import RobotSettings, RobotState, build_mujoco_model, collision_shapes, load_robot, standing_qpos
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import (
    OUTCOME_NAMES,
    ClosedLoop,
    MjxSlots,
    MujocoPhysics,
    MujocoSlots,
    Recorder,
    Slots,
    batch_loop,
    gather,
    mjx_init,
    mjx_loop,
    policy_guidance,
    stream,
)

CONTROL = ControlSettings()
ROBOT = load_robot(RobotSettings())
TARGET = [1.0, 0.0, 0.27, 0.0]
SCENE = make_scene(SceneSettings.model_validate({"target": TARGET}))
MODEL = build_mujoco_model(SCENE, RobotSettings(), CONTROL.control_dt)
STARTS = np.array([TARGET, [0.0, 0.0, 0.27, 0.0]])  # at the target, and where it will never get there
LIMITS = np.array([2.0, 0.3])


class Standing(NamedTuple):
    """The state of `PostureController`."""

    posture: jax.Array  # (12,) that it holds [rad]
    plans: jax.Array  # () int32


class PostureController:
    """Joint PD to the posture that the episode began with."""

    def init(self, robot_state: RobotState) -> Standing:
        return Standing(robot_state.joint_pos, jnp.int32(0))

    def plan(self, state: Standing, robot_state: RobotState, reference: Reference) -> Standing:
        return state._replace(plans=state.plans + 1)

    def act(self, state: Standing, robot_state: RobotState) -> tuple[Standing, jax.Array]:
        torque = 100.0 * (state.posture - robot_state.joint_pos) - 1.0 * robot_state.joint_vel
        return state, jnp.clip(torque, -ROBOT.torque_limit, ROBOT.torque_limit)

    def diagnostics(self, state: Standing) -> Diagnostics:
        return no_diagnostics()._replace(iterations=state.plans)


def loop() -> ClosedLoop:
    controller = PostureController()
    assert isinstance(controller, Controller)
    guidance = policy_guidance(lambda parameters, pose, velocity, dt: jnp.zeros(4))
    return ClosedLoop(SCENE, ROBOT, collision_shapes(MODEL), CONTROL, guidance, np.full(4, 1.5), controller)


def check(slots: Slots) -> None:
    qpos = np.stack([standing_qpos(ROBOT, start) for start in STARTS])
    recorder = Recorder(slots, 1)
    rollout = gather(2, stream(slots, np.asarray(qpos, float), LIMITS, recorder))
    assert [OUTCOME_NAMES[code] for code in rollout.outcome.status] == ["success", "timeout"]
    assert rollout.outcome.time[0] == pytest.approx(0.5, abs=0.01)  # it had only to stay
    trace = recorder.traces(SCENE, CONTROL.plan_dt)[0]
    assert np.abs(trace.qpos[:, 2] - 0.27).max() < 0.02
    assert 0.1 < np.abs(trace.torque[-1]).max() < 33.5
    assert all((counts == 0).all() for counts in rollout.counts)


def test_another_controller_stands_in_mujoco():
    with MujocoPhysics(MODEL, 2, 1) as physics:
        slots = MujocoSlots(batch_loop(loop()), physics, ())
        check(slots)
        assert slots._episodes is not None
        np.testing.assert_array_equal(slots._episodes.controller.plans, slots._episodes.diagnostics.iterations)


def test_another_controller_stands_in_mjx():
    check(MjxSlots(mjx_loop(loop(), mjx_init(MODEL)), 2, ()))
