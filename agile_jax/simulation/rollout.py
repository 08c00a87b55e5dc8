"""The closed loop of one robot, apart from its physics: policy, reference, controller, outcome.

Both backends run the same two functions, `plan` at the rate of the MPC and `act` at the rate of the torques; they
differ only in who integrates the physics between two calls of `act`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.control import ControllerState, ControlSettings, keep_counts, make_controller
from agile_jax.robot import CollisionShapes, RobotModel, body_clearance, robot_state
from agile_jax.scene import Scene
from agile_jax.simulation.outcome import RUNNING, Outcome, init_outcome, trunk_pose, update_outcome
from agile_jax.simulation.reference import Command, ReferenceState, plan_reference
from agile_jax.simulation.sensed import Sensed


class Episode(NamedTuple):
    """State of one closed loop."""

    controller: ControllerState
    reference: ReferenceState
    outcome: Outcome
    torque: jax.Array  # (12,) [Nm]


class ClosedLoop(NamedTuple):
    """Pure functions of one robot; vmap them."""

    init: Callable[[Sensed, jax.Array], Episode]  # (sensed, time_limit)
    plan: Callable[[Any, Any, Episode, Sensed], Episode]  # (policy parameters, path, episode, sensed)
    act: Callable[[Episode, Sensed], Episode]  # judges the last step, then sets the torque of the next
    control_dt: float  # [s]
    acts_per_plan: int


def resume_from(mask: jax.Array, fresh: Any, old: Any) -> Any:
    """Batched states that are `fresh` where `mask`, shape (n,), is set, and `old` elsewhere."""

    def choose(new: jax.Array, before: jax.Array) -> jax.Array:
        return jnp.where(mask.reshape(-1, *([1] * (new.ndim - 1))), new, before)

    return jax.tree.map(choose, fresh, old)


def make_closed_loop(
    scene: Scene,
    robot: RobotModel,
    shapes: CollisionShapes,
    settings: ControlSettings,
    command: Command,
    acceleration_limit: np.ndarray,
) -> ClosedLoop:
    """Compose the loop.

    Args:
        scene: target and obstacles, for the outcome only.
        robot: constants.
        shapes: of the robot, for the outcome only.
        settings: of the controller.
        command: what to follow: `policy_command` of a policy, or `path_command`.
        acceleration_limit: of the reference, shape (4,).
    """
    controller = make_controller(robot, settings)
    limit = jnp.asarray(acceleration_limit, jnp.float32)

    def init(sensed: Sensed, time_limit: jax.Array) -> Episode:
        state = robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact)
        reference = ReferenceState(trunk_pose(sensed), jnp.zeros_like(limit))
        return Episode(controller.init(state), reference, init_outcome(time_limit), jnp.zeros(12))

    def plan(parameters: Any, path: Any, episode: Episode, sensed: Sensed) -> Episode:
        state = robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact)
        reference_state, reference = plan_reference(
            command, parameters, path, episode.reference, trunk_pose(sensed), episode.outcome.time, limit, settings
        )
        planned = counting(episode, controller.plan(episode.controller, state, reference))
        return episode._replace(controller=planned, reference=reference_state)

    def act(episode: Episode, sensed: Sensed) -> Episode:
        outcome = update_outcome(
            episode.outcome,
            sensed,
            scene,
            body_clearance(robot, shapes, scene, sensed.qpos),
            episode.reference.velocity[:2],
            episode.torque,
            jnp.asarray(robot.torque_limit, jnp.float32),
            settings.control_dt,
        )
        state, torque = controller.act(episode.controller, robot_state(sensed.qpos, sensed.qvel, sensed.foot_contact))
        return episode._replace(controller=counting(episode, state), outcome=outcome, torque=torque)

    def counting(episode: Episode, new: ControllerState) -> ControllerState:
        """The controller's new state; once the episode has ended, its counts stay."""
        running = episode.outcome.status == RUNNING
        return new._replace(diagnostics=keep_counts(running, new.diagnostics, episode.controller.diagnostics))

    return ClosedLoop(init, plan, act, settings.control_dt, round(settings.plan_dt / settings.control_dt))
