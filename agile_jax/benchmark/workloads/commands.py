"""Commands of a walk on flat ground: what the trunk should do, at random, and how a reference obeys.

A command is a velocity of the trunk along its own axes, a yaw rate and a height.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.geometry import rotation_2d
from agile_jax.scene import streams

HEIGHT_RATE = 4.0  # climb or crouch per height error [1/s]
CLIMB = 0.3  # fastest [m/s]


class Command(NamedTuple):
    """What one robot is told; leading axis n for n robots."""

    velocity: Float[AnyArray, "2"]  # forward and to the left [m/s]
    yaw_rate: Float[AnyArray, ""]  # [rad/s]
    height: Float[AnyArray, ""]  # of the trunk's origin [m]


def obey(command: Command, pose: Float[Array, "4"], velocity: Float[Array, "4"], dt: float) -> Float[Array, "4"]:
    """The velocity [m/s, rad/s] that a command wants after `dt` [s], from a pose [m, rad] and its velocity."""
    pose = pose + velocity * dt
    planar = rotation_2d(pose[3], jnp) @ command.velocity
    climb = jnp.clip(HEIGHT_RATE * (command.height - pose[2]), -CLIMB, CLIMB)
    return jnp.stack([planar[0], planar[1], climb, command.yaw_rate])


def random_commands(
    count: int,
    seed: int,
    forward: tuple[float, float],
    sideways: float,
    yaw_rate: float,
    height: float,
) -> Command:
    """Uniform commands of `count` robots: the first k of n are the same whatever n.

    Args:
        count: of the robots.
        seed: of the random numbers.
        forward: lowest and highest velocity ahead [m/s].
        sideways: largest velocity to either side [m/s].
        yaw_rate: largest to either side [rad/s].
        height: of the trunk [m].
    """
    rows = np.array([np.random.default_rng((seed, streams.COMMANDS, i)).uniform(size=3) for i in range(count)])
    low, high = forward
    velocity = np.stack([low + (high - low) * rows[:, 0], sideways * (2 * rows[:, 1] - 1)], -1)
    return Command(velocity, yaw_rate * (2 * rows[:, 2] - 1), np.full(count, height))
