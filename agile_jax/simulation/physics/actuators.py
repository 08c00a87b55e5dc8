"""Between a command and the joints of n simulated robots: delay, and what motors can give at a speed."""

import numpy as np
from jaxtyping import Bool, Float, Int

from agile_jax.robot import JOINT_COUNT, Plant, available_torque


class Actuators:
    """The motors of n robots; ideal ones, until `reset` tells of others."""

    def __init__(self, batch: int, limit: Float[np.ndarray, "12"], dt: float) -> None:
        """Args: batch: n; limit: of the torques [Nm]; dt: between two commands [s]."""
        self._limit, self._dt = limit, dt
        self._steps = np.zeros(batch, int)  # of delay
        self._no_load_speed = np.full(batch, np.inf)  # [rad/s]
        self._waiting = np.zeros((1, batch, JOINT_COUNT))  # commands, the latest first [Nm]

    def reset(self, robots: Int[np.ndarray, " k"], plant: Plant | None) -> None:
        """Some robots begin anew, no command on its way; `plant` has leading axis k, None are ideal motors."""
        self._steps[robots] = 0 if plant is None else np.rint(plant.delay / self._dt).astype(int)
        self._no_load_speed[robots] = np.inf if plant is None else plant.no_load_speed
        longest = self._steps.max() + 1
        if longest > len(self._waiting):
            more = np.zeros((longest - len(self._waiting), *self._waiting.shape[1:]))
            self._waiting = np.concatenate([self._waiting, more])
        self._waiting[:, robots] = 0.0

    def __call__(
        self, torques: Float[np.ndarray, "n 12"], joint_vel: Float[np.ndarray, "n 12"], active: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 12"]:
        """The torques of the next step from the commands; those of robots that are not active wait [Nm]."""
        if len(self._waiting) > 1:
            self._waiting[1:, active] = self._waiting[:-1, active]
            self._waiting[0] = torques
            torques = self._waiting[self._steps, np.arange(len(torques))]
        if np.isfinite(self._no_load_speed).any():
            torques = available_torque(torques, joint_vel, self._limit, self._no_load_speed)
        return torques
