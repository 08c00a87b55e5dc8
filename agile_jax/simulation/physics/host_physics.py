"""Many episodes in a physics that the host steps: what is the same whichever engine it is."""

from abc import ABC, abstractmethod

import mujoco
import numpy as np

from agile_jax.robot import LEG_COUNT, Plant, plant_model
from agile_jax.simulation.physics.actuators import Actuators
from agile_jax.simulation.sensed import Sensed

_HUGE = 1e10  # MuJoCo calls a larger number bad (mjMAXVAL)


class HostPhysics(ABC):
    """A batch of independent episodes.

    An episode's result depends on nothing but its own start and torques: not on its neighbours, nor on what ran before
    in its place.

    A torque or state that is not finite makes the state NaN, and it stays so: the episode is not stepped again until it
    is reset.
    """

    def __init__(self, model: mujoco.MjModel, batch: int, substeps: int) -> None:
        """Allocate the episodes.

        Args:
            model: from `robot.build_mujoco_model`.
            batch: n, number of episodes.
            substeps: time steps of the model between two torques.
        """
        self.model = model
        self.batch = batch
        self._substeps = substeps
        self._models = [model] * batch
        self._actuators = Actuators(batch, model.actuator_ctrlrange[:, 1], substeps * model.opt.timestep)
        self._qpos = np.zeros((batch, model.nq))
        self._qvel = np.zeros((batch, model.nv))
        # Obstacle, floor and foot contacts, in the order of `Sensed`.
        self._contacts = np.zeros(batch, bool), np.zeros(batch, bool), np.zeros((batch, LEG_COUNT), bool)

    def reset(self, qpos: np.ndarray, episodes: np.ndarray | None = None, plants: Plant | None = None) -> Sensed:
        """Start episodes anew and at rest.

        Args:
            qpos: coordinates, shape (k, 19).
            episodes: k indices, by default all.
            plants: of the k robots; by default they are as the model says.
        """
        chosen = np.arange(self.batch) if episodes is None else episodes
        for i, episode in enumerate(chosen):
            self._models[episode] = self.model if plants is None else plant_model(self.model, plants.of(i))
        self._actuators.reset(chosen, plants)
        self._qpos[chosen] = qpos
        self._qvel[chosen] = 0.0
        for contact in self._contacts:
            contact[chosen] = False
        self._start(chosen)
        return self._sensed()

    def step(self, torques: np.ndarray, active: np.ndarray | None = None, pushes: np.ndarray | None = None) -> Sensed:
        """Advance by the time between two torques.

        Args:
            torques: shape (n, 12) [Nm]; clamped to the model's limits.
            active: shape (n,) bool; the others stay as they are, contact flags included. Default: all.
            pushes: force on each trunk's centre of mass in the world, shape (n, 3) [N]. Default: none.

        Returns:
            The batched state, in arrays of its own.
        """
        torques = np.asarray(torques, float)
        active = np.ones(self.batch, bool) if active is None else np.asarray(active)
        torques = self._actuators(torques, self._qvel[:, 6:], active)
        sound = self._sound() & np.isfinite(torques).all(-1)
        self._qpos[active & ~sound] = self._qvel[active & ~sound] = np.nan
        moving = np.flatnonzero(active & sound)
        if len(moving):
            self._step_episodes(moving, torques[moving], None if pushes is None else pushes[moving])
        broken = active & ~self._sound()  # a state that is not finite touches nothing
        for contact in self._contacts:
            contact[broken] = False
        return self._sensed()

    @abstractmethod
    def close(self) -> None:
        """Free what the engine holds."""

    def __enter__(self) -> "HostPhysics":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def _start(self, episodes: np.ndarray) -> None:
        """Begin k episodes at their coordinates, at rest; `episodes` are indices."""

    @abstractmethod
    def _step_episodes(self, episodes: np.ndarray, torques: np.ndarray, pushes: np.ndarray | None) -> None:
        """Step k sound episodes, indices, under finite torques (k, 12) and pushes (k, 3); set states and contacts."""

    def _sound(self) -> np.ndarray:
        """Episodes whose state MuJoCo accepts: shape (n,). A NaN fails the comparison."""
        return np.all(np.abs(self._qpos) < _HUGE, -1) & np.all(np.abs(self._qvel) < _HUGE, -1)

    def _sensed(self) -> Sensed:
        # Copies: JAX may use a NumPy array's memory in place, and the next step overwrites it.
        return Sensed(self._qpos.copy(), self._qvel.copy(), *(contact.copy() for contact in self._contacts))
