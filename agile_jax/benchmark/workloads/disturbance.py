"""What goes wrong on a robot and the controller does not know: pushes, a wrong model, noise, delay.

Physics and what is sensed are disturbed; the controller keeps the constants of the undisturbed robot. Every episode
draws its own signs, directions, times and noise from its own random stream.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from agile_jax.arrays import AnyArray
from agile_jax.geometry import quaternion_to_rpy
from agile_jax.robot import Plant, PlantSettings, draw_plants
from agile_jax.scene import streams
from agile_jax.simulation.sensed import Sensed

PUSH_DURATION = 0.1  # [s]
PUSH_WINDOW = (2.0, 3.0)  # when a push begins, drawn uniformly [s]
DRIFT_TIME = 1.0  # correlation time of the orientation's error [s]


class SensorNoise(NamedTuple):
    """Standard deviations of what is added to the sensed state; white unless said otherwise."""

    orientation: tuple[float, float, float] = (0.0, 0.0, 0.0)  # roll, pitch, yaw, over about a second [rad]
    angular_velocity: float = 0.0  # [rad/s]
    linear_velocity: float = 0.0  # [m/s]
    joint_pos: float = 0.0  # [rad]
    joint_vel: float = 0.0  # [rad/s]


class Disturbance(NamedTuple):
    """What disturbs every episode; the default is nothing."""

    impulse: float = 0.0  # sideways on the trunk, to the left or to the right, over 0.1 s [N s]
    plant: PlantSettings = PlantSettings()  # joints, friction, motors, delay
    trunk_mass: float = 0.0  # share of the trunk's mass added or taken away
    com_offset: float = 0.0  # of the trunk's centre of mass, in a random direction of the plane [m]
    torque_noise: float = 0.0  # relative: a constant error of every joint, and as much again anew at every step
    noise: SensorNoise = SensorNoise()


class Draws(NamedTuple):
    """What an episode drew, with a leading axis n for n episodes. It depends neither on the disturbance nor on n."""

    sign: Float[AnyArray, ""]  # -1 or 1
    angle: Float[AnyArray, ""]  # [rad]
    push_begin: Float[AnyArray, ""]  # [s]
    torque_error: Float[AnyArray, "12"]  # standard normal
    key: UInt32[AnyArray, "2"]  # of the noise


def draw(episodes: int, seed: int) -> Draws:
    """The draws of episodes 0, 1, ..."""
    generators = [np.random.default_rng((seed, streams.DISTURBANCES, episode)) for episode in range(episodes)]
    rows = [
        (rng.choice([-1.0, 1.0]), rng.uniform(0, 2 * np.pi), rng.uniform(*PUSH_WINDOW), rng.normal(size=12))
        for rng in generators
    ]
    sign, angle, begin, error = (np.array(column) for column in zip(*rows, strict=True))
    keys = np.stack([np.full(episodes, seed, np.uint32), np.arange(episodes, dtype=np.uint32)], -1)
    return Draws(sign, angle, begin, error, keys)


def disturbed_plants(disturbance: Disturbance, draws: Draws) -> Plant | None:
    """The robots, or none where they are as the controller believes."""
    if disturbance.plant == PlantSettings() and not disturbance.trunk_mass and not disturbance.com_offset:
        return None
    seed, episodes = int(draws.key[0, 0]), np.asarray(draws.key[:, 1], int)
    drawn = draw_plants(disturbance.plant, (seed, streams.PLANTS), episodes)
    away = np.stack([np.cos(draws.angle), np.sin(draws.angle), np.zeros(len(episodes))], -1)
    return drawn._replace(
        mass=drawn.mass * (1.0 + draws.sign * disturbance.trunk_mass),
        com_shift=drawn.com_shift + disturbance.com_offset * away,
    )


def push_force(
    disturbance: Disturbance, draws: Draws, time: float, qpos: Float[np.ndarray, "n 19"]
) -> Float[np.ndarray, "n 3"] | None:
    """Force on the trunks in the world at a time [s], or none where nothing ever pushes. In [N]."""
    if not disturbance.impulse:
        return None
    now = (time >= draws.push_begin) & (time < draws.push_begin + PUSH_DURATION)
    yaw = quaternion_to_rpy(qpos[:, 3:7])[:, 2]
    left = np.stack([-np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)], -1)
    return (now * draws.sign * disturbance.impulse / PUSH_DURATION)[:, None] * left


def sense(sensed: Sensed, noise: SensorNoise, drift: Float[Array, "3"], key: jax.Array) -> Sensed:
    """What the controller sees of one robot.

    Args:
        sensed: the truth.
        noise: standard deviations.
        drift: present error of roll, pitch, yaw, in standard deviations.
        key: of this step.
    """
    white = jax.random.normal(key, (30,))
    turn = jnp.asarray(noise.orientation) * drift / 2
    x, y, z = turn
    w0, x0, y0, z0 = sensed.qpos[3:7]
    quat = jnp.stack(  # to first order, normalised: (1, turn) times the true one
        [
            w0 - x * x0 - y * y0 - z * z0,
            x0 + x * w0 + y * z0 - z * y0,
            y0 + y * w0 + z * x0 - x * z0,
            z0 + z * w0 + x * y0 - y * x0,
        ]
    )
    joints = sensed.qpos[7:] + noise.joint_pos * white[:12]
    scale = jnp.array([noise.linear_velocity] * 3 + [noise.angular_velocity] * 3 + [noise.joint_vel] * 12)
    return sensed._replace(
        qpos=jnp.concatenate([sensed.qpos[:3], quat / jnp.sqrt(jnp.sum(quat**2)), joints]),
        qvel=sensed.qvel + scale * white[12:],
    )


def next_drift(drift: Float[Array, "3"], key: jax.Array, dt: float) -> Float[Array, "3"]:
    """Ornstein-Uhlenbeck process of unit variance, one step of `dt` [s] on."""
    keep = float(np.exp(-dt / DRIFT_TIME))
    return keep * drift + np.sqrt(1 - keep**2) * jax.random.normal(key, (3,))
