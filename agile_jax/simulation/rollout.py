"""The closed loop of one robot, apart from its physics: policy, reference, controller, outcome.

Both backends run the same two functions, `plan` at the rate of the MPC and `act` at the rate of the torques; they
differ only in who integrates the physics between two calls of `act`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.control import ControllerState, ControlSettings, make_controller
from agile_jax.robot import RobotModel, robot_state
from agile_jax.scene import Scene
from agile_jax.simulation.outcome import RUNNING, Outcome, init_outcome, trunk_pose, update_outcome
from agile_jax.simulation.reference import Field, ReferenceState, plan_reference
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
    plan: Callable[[Any, Episode, Sensed], Episode]  # (policy parameters, episode, sensed)
    act: Callable[[Episode, Sensed], Episode]  # judges the last step, then sets the torque of the next
    control_dt: float  # [s]
    acts_per_plan: int


class Trace(NamedTuple):
    """One recorded episode at the rate of the MPC, K samples."""

    time: np.ndarray  # (K,) [s]
    qpos: np.ndarray  # (K, 19)
    qvel: np.ndarray  # (K, 18)
    torque: np.ndarray  # (K, 12) [Nm]
    reference: np.ndarray  # (K, 8) pose and velocity of the reference
    clearance: np.ndarray  # (K,) of the torso's envelope [m]


def keep_counts(episode: Episode, state: ControllerState) -> ControllerState:
    """The controller's new state; once the episode has ended, its counts stay."""
    running = episode.outcome.status == RUNNING
    counts = jax.tree.map(
        lambda new, old: jnp.where(running, new, old), state.diagnostics.counts, episode.controller.diagnostics.counts
    )
    return state._replace(diagnostics=state.diagnostics._replace(counts=counts))


def make_closed_loop(
    scene: Scene, robot: RobotModel, settings: ControlSettings, field: Field, acceleration_limit: np.ndarray
) -> ClosedLoop:
    """Compose the loop.

    Args:
        scene: target and obstacles, for the outcome only.
        robot: constants.
        settings: of the controller.
        field: velocity field of the policy.
        acceleration_limit: of the reference, shape (4,).
    """
    controller = make_controller(robot, settings)
    limit = jnp.asarray(acceleration_limit, jnp.float32)

    def init(sensed: Sensed, time_limit: jax.Array) -> Episode:
        state = robot_state(sensed.qpos, sensed.qvel)
        reference = ReferenceState(trunk_pose(sensed), jnp.zeros_like(limit))
        return Episode(controller.init(state), reference, init_outcome(time_limit), jnp.zeros(12))

    def plan(parameters: Any, episode: Episode, sensed: Sensed) -> Episode:
        state = robot_state(sensed.qpos, sensed.qvel)
        reference_state, reference = plan_reference(
            field, parameters, episode.reference, trunk_pose(sensed), limit, settings
        )
        planned = controller.plan(episode.controller, state, reference)
        return episode._replace(controller=keep_counts(episode, planned), reference=reference_state)

    def act(episode: Episode, sensed: Sensed) -> Episode:
        saturated = jnp.sum(jnp.abs(episode.torque) >= robot.torque_limit * 0.9999).astype(jnp.float32)
        outcome = update_outcome(
            episode.outcome, sensed, scene, episode.reference.velocity[:2], saturated, settings.control_dt
        )
        state, torque = controller.act(episode.controller, robot_state(sensed.qpos, sensed.qvel))
        return episode._replace(controller=keep_counts(episode, state), outcome=outcome, torque=torque)

    return ClosedLoop(init, plan, act, settings.control_dt, round(settings.plan_dt / settings.control_dt))
