"""What the closed loop asks of a controller. `make_controller` makes the one of this library; another may stand in."""

from typing import Protocol, TypeVar, runtime_checkable

from jaxtyping import Array, Float

from agile_jax.control.body import Reference
from agile_jax.control.diagnostics import Diagnostics
from agile_jax.robot import RobotState

State = TypeVar("State")  # what a controller remembers between calls: a pytree of arrays of its own choice


@runtime_checkable
class Controller(Protocol[State]):
    """Pure functions of one robot, which the caller vmaps and compiles: they run in C MuJoCo and in MJX."""

    def init(self, robot_state: RobotState) -> State:
        """Begin an episode.

        Args:
            robot_state: measured, of a robot at rest.

        Returns:
            The state of the controller.
        """

    def plan(self, state: State, robot_state: RobotState, reference: Reference) -> State:
        """Plan ahead, every `ControlSettings.plan_dt` [s].

        Args:
            state: of the controller, from `init` or `act`.
            robot_state: measured.
            reference: poses and velocities that the trunk should have, now and at the nodes of the horizon.

        Returns:
            The state that the next calls of `act` use.
        """

    def act(self, state: State, robot_state: RobotState) -> tuple[State, Float[Array, "12"]]:
        """Command the joints, every `ControlSettings.control_dt` [s].

        Args:
            state: of the controller, from `plan` or `act`.
            robot_state: measured.

        Returns:
            The state, and the torques of the joints, legs FR, FL, RR, RL, joints abad, hip, knee [Nm].
        """

    def diagnostics(self, state: State) -> Diagnostics:
        """What the controller says about its last plan and command, and its counts since `init`.

        Episodes record it. A controller that counts nothing returns `no_diagnostics()`.
        """
