"""What the controller of one robot is told of its state: the truth, or what an estimator makes of simulated sensors."""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree, UInt32

from agile_jax.control import Belief, Estimator, Measured
from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot import GRAVITY, RobotState, SensorSettings, trunk_pose
from agile_jax.simulation.sensed import Sensed


@runtime_checkable
class Perception(Protocol):
    """Pure functions of one robot, for `ClosedLoop`."""

    def init(self, sensed: Sensed, key: UInt32[Array, "2"]) -> PyTree:
        """Begin an episode.

        Args:
            sensed: of a robot at rest.
            key: of what is random.
        """

    def look(self, state: PyTree, sensed: Sensed) -> tuple[PyTree, RobotState]:
        """One step of the torques on: the new state, and what the controller is told."""


@dataclasses.dataclass(frozen=True)
class Ideal:
    """The truth."""

    def init(self, sensed: Sensed, key: UInt32[Array, "2"]) -> None:
        """Nothing is remembered."""

    def look(self, state: None, sensed: Sensed) -> tuple[None, RobotState]:
        """What the physics tells."""
        return None, sensed.robot_state


IDEAL = Ideal()


class Sensors(NamedTuple):
    """State of the sensors of one robot."""

    key: UInt32[Array, "2"]
    step: Int[Array, ""]
    gyro_bias: Float[Array, "3"]  # [rad/s]
    accelerometer_bias: Float[Array, "3"]  # [m/s^2]
    encoder_bias: Float[Array, "12"]  # [rad]
    velocity: Float[Array, "3"]  # of the trunk at the last sample, in the world [m/s]
    waiting: Measured  # the latest first, leading axis delay + 1


@dataclasses.dataclass(frozen=True, eq=False)
class Estimated:
    """An estimate from sensors, whose samples come late."""

    settings: SensorSettings
    estimator: Estimator

    def init(self, sensed: Sensed, key: UInt32[Array, "2"]) -> tuple[Sensors, Belief]:
        """The robot is told x, y and yaw; all else it measures."""
        draws = jax.random.normal(jax.random.fold_in(key, 0), (18,))
        settings = self.settings
        sensors = Sensors(
            key,
            jnp.int32(1),
            settings.gyro_bias * draws[:3],
            settings.accelerometer_bias * draws[3:6],
            settings.encoder_bias * draws[6:],
            sensed.qvel[:3],
            waiting=Measured(*[jnp.zeros(0)] * len(Measured._fields)),
        )
        first = self._sample(sensors, sensed)
        samples = 1 + round(settings.delay / self.estimator.dt)
        waiting = jax.tree.map(lambda value: jnp.broadcast_to(value, (samples, *value.shape)), first)
        return sensors._replace(step=jnp.int32(2), waiting=waiting), self.estimator.init(first)

    def look(self, state: tuple[Sensors, Belief], sensed: Sensed) -> tuple[tuple[Sensors, Belief], RobotState]:
        """Measure, and believe what was measured a delay ago."""
        sensors, belief = state
        waiting = jax.tree.map(
            lambda old, new: jnp.concatenate([new[None], old[:-1]]), sensors.waiting, self._sample(sensors, sensed)
        )
        sensors = sensors._replace(step=sensors.step + 1, velocity=sensed.qvel[:3], waiting=waiting)
        measured: Measured = jax.tree.map(lambda value: value[-1], waiting)
        belief = self.estimator.update(belief, measured)
        return (sensors, belief), self.estimator.robot_state(belief, measured)

    def _sample(self, sensors: Sensors, sensed: Sensed) -> Measured:
        """What the sensors see now; acceleration is the mean since the last sample."""
        settings, dt = self.settings, self.estimator.dt
        draws = jax.random.normal(jax.random.fold_in(sensors.key, sensors.step), (33,))
        gyro, accelerometer, joint_pos, joint_vel, place = jnp.split(draws, [3, 6, 18, 30])
        acceleration = (sensed.qvel[:3] - sensors.velocity) / dt
        force_base = acceleration.at[2].add(GRAVITY) @ quaternion_to_matrix(sensed.qpos[3:7], jnp)
        pose = trunk_pose(sensed.qpos, jnp)[jnp.array([0, 1, 3])]
        located = jnp.bool_(False)
        if settings.localisation_rate > 0:
            located = sensors.step % max(1, round(1 / (settings.localisation_rate * dt))) == 0
            pose += jnp.array(settings.localisation_noise)[jnp.array([0, 0, 1])] * place
        return Measured(
            sensed.qvel[3:6] + sensors.gyro_bias + settings.gyro_noise * gyro,
            force_base + sensors.accelerometer_bias + settings.accelerometer_noise * accelerometer,
            sensed.qpos[7:] + sensors.encoder_bias + settings.encoder_noise * joint_pos,
            sensed.qvel[6:] + settings.joint_velocity_noise * joint_vel,
            jnp.asarray(sensed.foot_contact),
            located,
            pose,
        )
