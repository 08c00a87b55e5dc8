"""The state of the trunk from an IMU, encoders and the feet that stand: an error-state Kalman filter.

The IMU is integrated for position, velocity and orientation (Bloesch et al. 2012); a foot that feels the floor stands
still and is as high as the floor, which is flat and level (Bledt et al. 2018), so the legs measure velocity (Camurri
et al. 2020) and height. Roll and pitch come out of the same filter: what the accelerometer feels beside gravity is the
acceleration that the legs measure. Nothing measures the place in the plane and the yaw, which are counted on from
where the robot has been told that it starts, unless something else locates it.

The error is true minus estimated: of position, of velocity, of orientation (a small turn, R = exp(turn) R_estimated),
all in the world, then of the biases of gyroscope and accelerometer along the trunk's axes.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.control.estimator.kalman import correct, predict
from agile_jax.control.estimator.measured import Measured
from agile_jax.geometry import (
    quaternion_product,
    quaternion_to_matrix,
    quaternion_to_rpy,
    rotation_quaternion,
    wrap_angle,
)
from agile_jax.robot import (
    GRAVITY,
    RobotModel,
    RobotState,
    SensorSettings,
    leg_forward_kinematics,
    leg_jacobian,
    link_poses,
)

POSITION, VELOCITY, TURN, GYRO, ACCELEROMETER = (slice(first, first + 3) for first in range(0, 15, 3))  # of the error

# What the equations leave out, as standard deviations at each sample, beside the sensors' own noise. Those of the feet
# were found on the A1 in C MuJoCo, on eight walks from the paper's starts under its table: a foot that has touched
# slides for some 20 ms, then creeps with 0.03 m/s, sinks by 1 to 2 mm, and all of this lasts over many samples.
MODEL_TURN_RATE, MODEL_ACCELERATION = 1e-3, 0.02  # vibration, and the mean over a sample [rad/s, m/s^2]
SLIP, SINKING_SPEED = 0.1, 0.2  # of a foot that stands [m/s]
LANDING, LANDING_TIME = 10.0, 0.015  # so much more of one that has just touched, and how soon that is over [-, s]
SINKING = 0.005  # of a foot into the floor, or the floor's unevenness [m]
OUTLIER = 4.0  # a foot whose squared error over its variance is larger gets so much less weight: it slips
BIAS_TIME = 100.0  # over which biases wander by their standard deviation [s]
START = 0.01, 0.02  # errors at the start, of height [m] and velocity [m/s]
START_POSE = 1e-3, 5e-3  # in the plane [m] and of the yaw [rad], where the start is told once and for all


class Belief(NamedTuple):
    """What the filter of one robot believes."""

    position: Float[Array, "3"]  # of the trunk's origin in the world [m]
    velocity: Float[Array, "3"]  # in the world [m/s]
    quat: Float[Array, "4"]  # world from base, wxyz
    gyro_bias: Float[Array, "3"]  # [rad/s]
    accelerometer_bias: Float[Array, "3"]  # [m/s^2]
    covariance: Float[Array, "15 15"]  # of the error
    standing_time: Float[Array, "4"]  # since when each foot touches [s]


class Observation(NamedTuple):
    """m things that are known of the error: innovation = rows @ error + noise."""

    rows: Float[Array, "m 15"]
    variance: Float[Array, " m"]
    innovation: Float[Array, " m"]


@dataclasses.dataclass(frozen=True, eq=False)
class Estimator:
    """Pure functions of one robot; the caller vmaps and compiles them.

    Attributes:
        robot: constants.
        sensors: what is known of their noise.
        dt: between two samples [s].
    """

    robot: RobotModel
    sensors: SensorSettings
    dt: float

    def init(self, measured: Measured) -> Belief:
        """What a robot at rest believes that is told x, y and yaw; it measures its height and tilt."""
        place_x, place_y, yaw = measured.planar_pose
        up = measured.specific_force / jnp.sqrt(jnp.sum(measured.specific_force**2))
        pitch = jnp.arcsin(jnp.clip(-up[0], -1.0, 1.0))
        roll = jnp.arctan2(up[1], up[2])
        about_x, about_y, about_z = rotation_quaternion(jnp.diag(jnp.stack([roll, pitch, yaw])), jnp)
        quat = _turned(_turned(about_z, about_y), about_x)
        feet_world = leg_forward_kinematics(self.robot, measured.joint_pos) @ quaternion_to_matrix(quat, jnp).T
        height = self.robot.foot_radius - feet_world[:, 2].mean()
        place, turn = self._location_deviations if self.sensors.localisation_rate > 0 else START_POSE
        level, speed = START
        gyro, accelerometer = self._bias_deviations
        tilt = np.hypot(accelerometer, self._acceleration_deviation) / GRAVITY
        deviations = [place, place, level, speed, speed, speed, tilt, tilt, turn, *[gyro] * 3, *[accelerometer] * 3]
        return Belief(
            jnp.stack([place_x, place_y, height]),
            jnp.zeros(3),
            quat,
            jnp.zeros(3),
            jnp.zeros(3),
            jnp.diag(jnp.square(jnp.asarray(deviations, jnp.float32))),
            jnp.zeros(4),
        )

    def update(self, belief: Belief, measured: Measured) -> Belief:
        """One sample on."""
        belief = self._predict(belief, measured)
        observations = [self._feet(belief, measured)]
        if self.sensors.localisation_rate > 0:
            observations.append(self._location(belief, measured))
        rows, variance, innovation = (jnp.concatenate(parts) for parts in zip(*observations, strict=True))
        error, covariance = correct(belief.covariance, rows, variance, innovation)
        return Belief(
            belief.position + error[POSITION],
            belief.velocity + error[VELOCITY],
            _turned(rotation_quaternion(error[TURN], jnp), belief.quat),
            belief.gyro_bias + error[GYRO],
            belief.accelerometer_bias + error[ACCELEROMETER],
            covariance,
            belief.standing_time,
        )

    def robot_state(self, belief: Belief, measured: Measured) -> RobotState:
        """The state now, as the measurements tell it, carried on by their age."""
        age = round(self.sensors.delay / self.dt) * self.dt
        force = quaternion_to_matrix(belief.quat, jnp) @ (measured.specific_force - belief.accelerometer_bias)
        acceleration = force.at[2].add(-GRAVITY)
        turn_rate = measured.angular_velocity - belief.gyro_bias
        return RobotState(
            belief.position + age * belief.velocity,
            _turned(belief.quat, rotation_quaternion(age * turn_rate, jnp)),
            belief.velocity + age * acceleration,
            turn_rate,
            measured.joint_pos + age * measured.joint_vel,
            measured.joint_vel,
            measured.foot_contact,
        )

    def _predict(self, belief: Belief, measured: Measured) -> Belief:
        dt = self.dt
        quat = _turned(belief.quat, rotation_quaternion(dt * (measured.angular_velocity - belief.gyro_bias), jnp))
        R_world_base = quaternion_to_matrix(quat, jnp)
        force_world = R_world_base @ (measured.specific_force - belief.accelerometer_bias)
        velocity = belief.velocity + dt * force_world.at[2].add(-GRAVITY)
        identity = jnp.eye(3)
        transition = jnp.eye(15).at[TURN, GYRO].set(-dt * R_world_base)
        transition = transition.at[VELOCITY, TURN].set(-dt * skew(force_world))
        transition = transition.at[VELOCITY, ACCELEROMETER].set(-dt * R_world_base)
        transition = transition.at[POSITION].set(transition[POSITION] + dt * transition[VELOCITY])
        transition = transition.at[POSITION, VELOCITY].set(dt * identity)
        turning = np.hypot(self.sensors.gyro_noise, MODEL_TURN_RATE) * dt
        pushing = self._acceleration_deviation * dt
        wandering = [deviation * np.sqrt(dt / BIAS_TIME) for deviation in self._bias_deviations]
        noise = np.repeat(np.square([0.0, pushing, turning, *wandering]), 3).astype(np.float32)
        return belief._replace(
            position=belief.position + dt * velocity,
            velocity=velocity,
            quat=quat,
            covariance=predict(belief.covariance, transition, jnp.asarray(noise)),
            standing_time=jnp.where(measured.foot_contact, belief.standing_time + dt, 0.0),
        )

    def _feet(self, belief: Belief, measured: Measured) -> Observation:
        """The contact point of a foot that touches does not move, a ball that rolls, and is on the floor."""
        robot, R = self.robot, quaternion_to_matrix(belief.quat, jnp)
        turn_rate, joint_vel = measured.angular_velocity - belief.gyro_bias, measured.joint_vel.reshape(4, 3)
        feet = leg_forward_kinematics(robot, measured.joint_pos)
        down = -robot.foot_radius * R[2]  # from a foot's centre to where it touches
        axis = link_poses(robot, measured.joint_pos).rotation[1::3, :, 1]  # of hip and knee
        rolling = joint_vel[:, :1] * jnp.array([1.0, 0.0, 0.0]) + (joint_vel[:, 1] + joint_vel[:, 2])[:, None] * axis
        moving = jnp.einsum("lij,lj->li", leg_jacobian(robot, measured.joint_pos), joint_vel)
        moving += jnp.cross(rolling, down) + jnp.cross(turn_rate, feet + down)
        feet_world, moving_world = feet @ R.T, moving @ R.T

        zero, identity = jnp.zeros((4, 3, 3)), jnp.broadcast_to(jnp.eye(3), (4, 3, 3))
        velocity_rows = jnp.concatenate([zero, identity, -skew(moving_world), R @ skew(feet + down), zero], -1)
        upward = jnp.zeros((4, 3)).at[:, 2].set(1.0)
        height_rows = jnp.concatenate([upward, jnp.zeros((4, 3)), jnp.cross(feet_world, upward), jnp.zeros((4, 6))], -1)
        rows = jnp.concatenate([velocity_rows, height_rows[:, None]], 1)  # (4, 4, 15)
        height = robot.foot_radius - belief.position[2] - feet_world[:, 2]
        innovation = jnp.concatenate([-belief.velocity - moving_world, height[:, None]], -1)  # (4, 4)

        reach, sensors = robot.thigh_length + robot.calf_length, self.sensors
        looseness = 1 + LANDING**2 * jnp.exp(-2 * belief.standing_time / LANDING_TIME)
        slip = looseness * SLIP**2 + (reach * sensors.joint_velocity_noise) ** 2
        sink = looseness * SINKING_SPEED**2 + (reach * sensors.joint_velocity_noise) ** 2
        sinking = SINKING**2 + (reach * sensors.encoder_noise) ** 2 + (reach * sensors.encoder_bias) ** 2
        variance = jnp.stack([slip, slip, sink, jnp.full(4, sinking)], -1)
        expected = jnp.einsum("lij,jk,lik->li", rows, belief.covariance, rows) + variance
        surprise = jnp.max(innovation**2 / expected, -1, keepdims=True)
        variance = variance * jnp.maximum(surprise / OUTLIER, 1.0)
        touches = measured.foot_contact[:, None]
        return Observation(
            jnp.where(touches[..., None], rows, 0.0).reshape(16, 15),
            variance.reshape(16),
            jnp.where(touches, innovation, 0.0).reshape(16),
        )

    def _location(self, belief: Belief, measured: Measured) -> Observation:
        """x, y and yaw, where something else tells them."""
        yaw = quaternion_to_rpy(belief.quat, jnp)[2]
        innovation = measured.planar_pose - jnp.stack([belief.position[0], belief.position[1], yaw])
        innovation = innovation.at[2].set(wrap_angle(innovation[2], jnp))
        rows = jnp.eye(15)[jnp.array([0, 1, 8])]
        place, turn = self._location_deviations
        variance = jnp.asarray(np.square([place, place, turn]), jnp.float32)
        return Observation(
            jnp.where(measured.located, rows, 0.0), variance, jnp.where(measured.located, innovation, 0.0)
        )

    @property
    def _location_deviations(self) -> tuple[float, float]:
        """Of x and y, and of the yaw [m, rad]; nothing is exact."""
        place, turn = self.sensors.localisation_noise
        return max(place, 1e-3), max(turn, 1e-3)

    @property
    def _bias_deviations(self) -> tuple[float, float]:
        """Of gyroscope and accelerometer [rad/s, m/s^2]."""
        return self.sensors.gyro_bias, self.sensors.accelerometer_bias

    @property
    def _acceleration_deviation(self) -> float:
        return float(np.hypot(self.sensors.accelerometer_noise, MODEL_ACCELERATION))


def skew(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """The matrix whose product with another vector is the cross product."""
    return jnp.cross(vector[..., None, :], jnp.eye(3)).mT


def _turned(first: Float[Array, "4"], second: Float[Array, "4"]) -> Float[Array, "4"]:
    """The product of two rotations, of length 1 again."""
    product = quaternion_product(first, second, jnp)
    return product / jnp.sqrt(jnp.sum(product**2))
