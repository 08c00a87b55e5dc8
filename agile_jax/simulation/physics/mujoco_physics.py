"""Many episodes in MuJoCo's C physics, spread over threads."""

import mujoco
import mujoco.rollout
import numpy as np

from agile_jax.robot.plant import TRUNK_BODY
from agile_jax.settings import BadInput
from agile_jax.simulation.physics.host_physics import HostPhysics
from agile_jax.simulation.sensed import contact_flags, touch_slots


def set_solver(model: mujoco.MjModel, integrator: str, cone: str) -> None:
    """Choose the integrator and the friction cone of a model, by MuJoCo's names in lower case."""
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    model.opt.cone = getattr(mujoco.mjtCone, f"mjCONE_{cone.upper()}")


class MujocoPhysics(HostPhysics):
    """Episodes stepped by the C++ threads of `mujoco.rollout`, whose number does not change results.

    (A pool of Python threads that each call mj_step loses to the interpreter's lock what it gains.)

    Left to itself, MuJoCo would replace a bad control by zero and go on.
    """

    def __init__(self, model: mujoco.MjModel, batch: int, threads: int, substeps: int = 1) -> None:
        """Allocate the episodes.

        Args:
            model: from `robot.build_mujoco_model`.
            batch: n, number of episodes.
            threads: that step them; 1 steps in the caller's thread.
            substeps: time steps of the model between two torques.

        Raises:
            BadInput: `threads` is not positive.
        """
        if threads < 1:
            raise BadInput(f"threads = {threads} must be at least 1")
        super().__init__(model, batch, substeps)
        self._slots = touch_slots(model)
        self._warmstart = np.zeros((batch, model.nv))  # of the contact solver: the last acceleration [m/s^2, rad/s^2]
        threads = min(threads, batch)
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._rollout = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)

    def close(self) -> None:
        """End the threads."""
        self._rollout.close()

    def _start(self, episodes: np.ndarray) -> None:
        self._warmstart[episodes] = 0.0

    def _step_episodes(self, episodes: np.ndarray, torques: np.ndarray, pushes: np.ndarray | None) -> None:
        control, kind, count = torques, mujoco.mjtState.mjSTATE_CTRL.value, len(episodes)
        if pushes is not None:
            wrenches = np.zeros((count, self.model.nbody, 6))
            wrenches[:, TRUNK_BODY, :3] = pushes
            control = np.concatenate([torques, wrenches.reshape(count, -1)], -1)
            kind |= mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
        # State as mujoco.rollout wants it: time, qpos, qvel. The model has no other.
        state = np.concatenate([np.zeros((count, 1)), self._qpos[episodes], self._qvel[episodes]], -1)
        states, sensordata = self._rollout.rollout(
            [self._models[episode] for episode in episodes],
            self._data,
            state,
            np.repeat(control[:, None], self._substeps, 1),
            control_spec=kind,
            nstep=self._substeps,
            initial_warmstart=self._warmstart[episodes],
        )
        before, after = np.concatenate([state[:, None], states], 1)[:, -2:].swapaxes(0, 1)
        self._qpos[episodes], self._qvel[episodes] = np.split(after[:, 1:], [self.model.nq], -1)
        self._warmstart[episodes] = ((after - before) / self.model.opt.timestep)[:, 1 + self.model.nq :]
        for contact, found in zip(self._contacts, contact_flags(sensordata, self._slots), strict=True):
            contact[episodes] = found.any(1)
