"""Many episodes in PyBullet, each in a client of its own, one after the other.

What MuJoCo and Bullet have alike is the rigid bodies: without damping, friction and armature they agree in flight to
rounding. What Bullet does its own way: contacts and joint limits are hard; the friction of the ground is a cone; the
damping of joints is an explicit torque; their dry friction is a motor that holds a joint with no more than so much
torque; armature is a rotor (urdf.py).
"""

import mujoco
import numpy as np

from agile_jax.simulation.physics.bullet_world import World
from agile_jax.simulation.physics.host_physics import HostPhysics


class BulletPhysics(HostPhysics):
    """Episodes in PyBullet; its calls hold the interpreter's lock, so that threads would not help."""

    def __init__(self, model: mujoco.MjModel, batch: int, substeps: int = 1, rotor_reaction: bool = True) -> None:
        """Allocate the episodes.

        Args:
            model: from `robot.build_mujoco_model`.
            batch: n, number of episodes.
            substeps: time steps of the model between two torques.
            rotor_reaction: whether rotors react on the links that carry them, which they do not in MuJoCo.
        """
        super().__init__(model, batch, substeps)
        self._worlds = [World(rotor_reaction) for _ in range(batch)]

    def close(self) -> None:
        """End the clients."""
        for world in self._worlds:
            world.close()

    def _start(self, episodes: np.ndarray) -> None:
        for episode in episodes:
            self._worlds[episode].start(self._models[episode], self._qpos[episode])

    def _step_episodes(self, episodes: np.ndarray, torques: np.ndarray, pushes: np.ndarray | None) -> None:
        for i, episode in enumerate(episodes):
            world = self._worlds[episode]
            touched = world.step(torques[i], None if pushes is None else pushes[i], self._substeps)
            self._qpos[episode], self._qvel[episode] = world.state()
            for contact, found in zip(self._contacts, touched, strict=True):
                contact[episode] = found
