"""The closed loop of one robot, apart from its physics: what is followed, reference, controller, outcome.

Both backends run the same two functions, `plan` at the rate of the MPC and `act` at the rate of the torques; they
differ only in who integrates the physics between two calls of `act`.
"""

import dataclasses
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree, UInt32

from agile_jax.control import Controller, ControlSettings, Diagnostics
from agile_jax.robot import CollisionShapes, RobotModel, body_clearance, own_clearance
from agile_jax.scene import Scene
from agile_jax.simulation.outcome import RUNNING, Outcome, init_outcome, update_outcome
from agile_jax.simulation.paths import TimedPath
from agile_jax.simulation.perception import IDEAL, Perception
from agile_jax.simulation.reference import Guidance, ReferenceState, plan_reference
from agile_jax.simulation.sensed import Sensed
from agile_jax.single_precision import in_float32

T = TypeVar("T")


class Episode(NamedTuple):
    """State of the closed loop of one robot."""

    controller: PyTree  # its state
    perception: PyTree  # its state
    reference: ReferenceState
    outcome: Outcome
    diagnostics: Diagnostics  # of the controller; once the episode has ended, its counts stay
    torque: Float[Array, "12"]  # of the next step [Nm]


@dataclasses.dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Pure functions of one robot; vmap them. The controller is an argument, and so is what it follows.

    Attributes:
        scene: target and obstacles, for the outcome only.
        robot: constants, for the outcome only.
        shapes: of the robot, for the outcome only.
        settings: clocks, and the horizon and `lead_limit` of the reference.
        guidance: what the reference follows: `policy_guidance` of a policy, or `path_guidance`.
        acceleration_limit: of the reference [m/s^2, rad/s^2].
        controller: for example `control.make_controller(robot, settings)`.
        perception: what controller and reference are told of the robot's state.
    """

    scene: Scene
    robot: RobotModel
    shapes: CollisionShapes
    settings: ControlSettings
    guidance: Guidance
    acceleration_limit: Float[np.ndarray, "4"]
    controller: Controller[PyTree]
    perception: Perception = IDEAL

    @property
    def acts_per_plan(self) -> int:
        """Time steps between two plans."""
        return round(self.settings.plan_dt / self.settings.control_dt)

    @in_float32
    def init(self, sensed: Sensed, time_limit: Float[Array, ""], key: UInt32[Array, "2"]) -> Episode:
        """Begin an episode.

        Args:
            sensed: of a robot at rest.
            time_limit: after which the episode ends [s].
            key: of what is random in the episode.
        """
        perception = self.perception.init(sensed, key)
        _, robot_state = self.perception.look(perception, sensed)
        state = self.controller.init(robot_state)
        reference = ReferenceState(robot_state.pose(jnp), jnp.zeros(4))
        diagnostics = self.controller.diagnostics(state)
        return Episode(state, perception, reference, init_outcome(time_limit), diagnostics, jnp.zeros(12))

    @in_float32
    def believed_pose(self, episode: Episode, sensed: Sensed) -> Float[Array, "4"]:
        """[x, y, z, yaw] of the trunk as the controller is told of it now [m, rad]."""
        return self.perception.look(episode.perception, sensed)[1].pose(jnp)

    @in_float32
    def plan(self, parameters: PyTree, path: TimedPath | None, episode: Episode, sensed: Sensed) -> Episode:
        """Advance the reference along what is followed, and let the controller plan; every `plan_dt` [s].

        Args:
            parameters: of the guidance, for example a policy's.
            path: that the guidance follows, if it follows one.
            episode: from `init` or `act`.
            sensed: now.
        """
        _, robot_state = self.perception.look(episode.perception, sensed)  # `act` looks at the same, and remembers
        reference_state, reference = plan_reference(
            partial(self.guidance, parameters, path),
            episode.reference,
            robot_state.pose(jnp),
            episode.outcome.time,
            jnp.asarray(self.acceleration_limit, jnp.float32),
            self.settings,
        )
        planned = self.controller.plan(episode.controller, robot_state, reference)
        return episode._replace(
            controller=planned, reference=reference_state, diagnostics=self._diagnostics(episode, planned)
        )

    @in_float32
    def act(self, episode: Episode, sensed: Sensed) -> Episode:
        """Judge the last step, then set the torques of the next; every `control_dt` [s].

        Args:
            episode: from `plan` or `act`.
            sensed: after the last step.
        """
        outcome = update_outcome(
            episode.outcome,
            sensed,
            self.scene,
            body_clearance(self.robot, self.shapes, self.scene, sensed.qpos),
            own_clearance(self.robot, self.shapes.own, sensed.qpos),
            episode.reference.velocity[:2],
            episode.torque,
            jnp.asarray(self.robot.torque_limit, jnp.float32),
            self.settings.control_dt,
        )
        perception, robot_state = self.perception.look(episode.perception, sensed)
        state, torque = self.controller.act(episode.controller, robot_state)
        return episode._replace(
            controller=state,
            perception=perception,
            outcome=outcome,
            diagnostics=self._diagnostics(episode, state),
            torque=torque,
        )

    def _diagnostics(self, episode: Episode, state: PyTree) -> Diagnostics:
        running = episode.outcome.status == RUNNING
        return counted_while(running, self.controller.diagnostics(state), episode.diagnostics)


def counted_while(running: Bool[Array, ""], new: Diagnostics, old: Diagnostics) -> Diagnostics:
    """The new diagnostics, with the old counts unless `running`."""
    counts = jax.tree.map(lambda after, before: jnp.where(running, after, before), new.counts, old.counts)
    return new._replace(counts=counts)


def resume_from(mask: Bool[Array, " n"], fresh: T, old: T) -> T:
    """Batched states that are `fresh` where `mask` is set, and `old` elsewhere."""

    def choose(new: jax.Array, before: jax.Array) -> jax.Array:
        return jnp.where(mask.reshape(-1, *([1] * (new.ndim - 1))), new, before)

    return jax.tree.map(choose, fresh, old)
