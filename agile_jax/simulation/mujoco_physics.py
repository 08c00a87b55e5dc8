"""Many episodes in MuJoCo's C physics, spread over threads."""

import mujoco
import mujoco.rollout
import numpy as np

from agile_jax.robot import Plant, plant_model
from agile_jax.robot.plant import TRUNK_BODY
from agile_jax.settings import BadInput
from agile_jax.simulation.actuators import Actuators
from agile_jax.simulation.sensed import Sensed, contact_flags, touch_slots

_HUGE = 1e10  # MuJoCo calls a larger number bad (mjMAXVAL)


class MujocoPhysics:
    """A batch of independent episodes, stepped by the C++ threads of `mujoco.rollout`.

    (A pool of Python threads that each call mj_step loses to the interpreter's lock what it gains.)

    An episode's result depends on nothing but its own start and torques: not on the number of threads, not on its
    neighbours.

    A torque or state that is not finite makes the state NaN, and it stays so: the episode is not stepped again until it
    is reset. Left to itself, MuJoCo would replace a bad control by zero and go on.
    """

    def __init__(self, model: mujoco.MjModel, batch: int, threads: int) -> None:
        """Allocate the episodes.

        Args:
            model: from `robot.build_mujoco_model`.
            batch: n, number of episodes.
            threads: that step them; 1 steps in the caller's thread.

        Raises:
            BadInput: `threads` is not positive.
        """
        if threads < 1:
            raise BadInput(f"threads = {threads} must be at least 1")
        self.model = model
        self.batch = batch
        self._models = [model] * batch
        self._actuators = Actuators(batch, model.actuator_ctrlrange[:, 1], model.opt.timestep)
        self._slots = touch_slots(model)
        # State as mujoco.rollout wants it: time, qpos, qvel. The model has no other.
        self._state = np.zeros((batch, 1 + model.nq + model.nv))
        self._qpos = self._state[:, 1 : 1 + model.nq]
        self._qvel = self._state[:, 1 + model.nq :]
        self._warmstart = np.zeros((batch, model.nv))  # of the contact solver: the last acceleration [m/s^2, rad/s^2]
        feet = len(self._slots.feet)
        # Obstacle, floor and foot contacts, in the order of `Sensed`.
        self._contacts = np.zeros(batch, bool), np.zeros(batch, bool), np.zeros((batch, feet), bool)
        threads = min(threads, batch)
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._rollout = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)

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
        self._state[chosen] = 0.0
        self._qpos[chosen] = qpos
        self._warmstart[chosen] = 0.0
        for contact in self._contacts:
            contact[chosen] = False
        return self._sensed()

    def step(self, torques: np.ndarray, active: np.ndarray | None = None, pushes: np.ndarray | None = None) -> Sensed:
        """Advance by one time step of the model.

        Args:
            torques: shape (n, 12) [Nm]; clamped to the limits by the model.
            active: shape (n,) bool; the others stay as they are, contact flags included. Default: all.
            pushes: force on each trunk's centre of mass in the world, shape (n, 3) [N]. Default: none.

        Returns:
            The batched state, in arrays of its own.
        """
        torques = np.asarray(torques, float)
        active = np.ones(self.batch, bool) if active is None else np.asarray(active)
        torques = self._actuators(torques, self._qvel[:, 6:], active)
        sound = self._sound() & np.isfinite(torques).all(-1)
        self._state[active & ~sound, 1:] = np.nan
        moving = np.flatnonzero(active & sound)
        if len(moving):
            self._step_episodes(moving, torques[moving], None if pushes is None else pushes[moving])
        broken = active & ~self._sound()  # a state that is not finite touches nothing
        for contact in self._contacts:
            contact[broken] = False
        return self._sensed()

    def close(self) -> None:
        """End the threads."""
        self._rollout.close()

    def __enter__(self) -> "MujocoPhysics":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _sound(self) -> np.ndarray:
        """Episodes whose state MuJoCo accepts: shape (n,). A NaN fails the comparison."""
        return np.all(np.abs(self._state) < _HUGE, axis=-1)

    def _step_episodes(self, episodes: np.ndarray, torques: np.ndarray, pushes: np.ndarray | None) -> None:
        control, kind = torques, mujoco.mjtState.mjSTATE_CTRL.value
        if pushes is not None:
            wrenches = np.zeros((len(episodes), self.model.nbody, 6))
            wrenches[:, TRUNK_BODY, :3] = pushes
            control = np.concatenate([torques, wrenches.reshape(len(episodes), -1)], -1)
            kind |= mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
        states, sensordata = self._rollout.rollout(
            [self._models[episode] for episode in episodes],
            self._data,
            self._state[episodes],
            control[:, None],
            control_spec=kind,
            nstep=1,
            initial_warmstart=self._warmstart[episodes],
        )
        velocity = self._qvel[episodes]
        self._state[episodes] = states[:, 0]
        self._warmstart[episodes] = (self._qvel[episodes] - velocity) / self.model.opt.timestep
        for contact, found in zip(self._contacts, contact_flags(sensordata[:, 0], self._slots), strict=True):
            contact[episodes] = found

    def _sensed(self) -> Sensed:
        # Copies: JAX may use a NumPy array's memory in place, and the next step overwrites it.
        return Sensed(self._qpos.copy(), self._qvel.copy(), *(contact.copy() for contact in self._contacts))
