"""The field in closed loop with a kinematic robot: a point in pose space that accelerates within bounds.

It answers what a mean squared error cannot: whether the field arrives, and whether it hits something on the way. A tick
of `dt` takes the field one tick ahead, at s + s' dt, because s' cannot change before, and tracks it like the reference
of the simulated robot does (tracker.py).
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.field import Policy
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.tracker import track
from agile_jax.scene import Scene, clearance, pose_error

ARRIVED, COLLIDED, STALLED, LOST = range(4)
OUTCOMES = ("arrived", "collided", "stalled", "lost")
STALL_SPEED = 0.01  # [m/s] at the end, away from the target


class Followed(NamedTuple):
    """n closed loops of K ticks."""

    outcome: np.ndarray  # (n,) int8, index into OUTCOMES; collided prevails
    arrival_time: np.ndarray  # (n,) [s], since when it is within the tolerance for good; infinity when never
    min_clearance: np.ndarray  # (n,) exact, of the torso's box, at the ticks and half-way between them [m]
    final_error: np.ndarray  # (n,) distance of the position to the target [m]
    poses: np.ndarray  # (n, K + 1, 4) [m, rad]

    def rate(self, outcome: int) -> float:
        """The fraction of the starts with this outcome."""
        return float((self.outcome == outcome).mean())


def follow(
    policy: Policy,
    params: PolicyParameters,
    scene: Scene,
    starts: np.ndarray,
    dt: float = 0.02,
    acceleration_limit: np.ndarray | None = None,
    duration: float = 15.0,
    tolerance: tuple[float, float] = (0.01, 0.03),
) -> Followed:
    """Integrate the field from rest at each start.

    Args:
        policy, params: the field.
        scene: obstacles and target.
        starts: shape (n, 4) [m, rad].
        dt: tick [s].
        acceleration_limit: of the robot, shape (4,) [m/s^2, rad/s^2]; none when not given.
        duration: of every loop [s].
        tolerance: distance [m] and yaw error [rad] that count as arrived.
    """
    limit = np.full(scene.target.shape, np.inf) if acceleration_limit is None else np.asarray(acceleration_limit)
    ticks = round(duration / dt)
    narrow = Scene(*(np.asarray(array, np.float32) for array in scene))
    run = jax.jit(
        jax.vmap(functools.partial(_loop, policy, narrow, dt, jnp.asarray(limit, jnp.float32), ticks), (None, 0))
    )
    poses, velocities, clearances = jax.device_get(run(params, jnp.asarray(starts, jnp.float32)))
    error = pose_error(narrow, poses)
    distance = np.linalg.norm(error[..., :3], axis=-1)
    inside = (distance <= tolerance[0]) & (np.abs(error[..., 3]) <= tolerance[1])  # False for NaN
    last_outside = ticks - np.argmin(inside[:, ::-1], axis=1)  # index of the last tick outside
    first = np.where(inside.all(1), 0, last_outside + 1)
    arrived = inside[:, -1]
    speed = np.linalg.norm(velocities[:, -1, :3], axis=-1)
    outcome = np.where(arrived, ARRIVED, np.where(speed < STALL_SPEED, STALLED, LOST))
    nearest = clearances.min(1)
    return Followed(
        outcome=np.where(nearest < 0, COLLIDED, outcome).astype(np.int8),
        arrival_time=np.where(arrived, first * dt, np.inf),
        min_clearance=nearest,
        final_error=distance[:, -1],
        poses=poses,
    )


def _loop(
    policy: Policy,
    scene: Scene,
    dt: float,
    acceleration_limit: jax.Array,
    ticks: int,
    params: PolicyParameters,
    start: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Poses and velocities (ticks + 1, 4) and clearances (ticks,) from one start."""

    def tick(carry: tuple[jax.Array, jax.Array], _: None) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, ...]]:
        pose, velocity = carry
        following = track(policy.velocity(params, pose + velocity * dt), velocity, acceleration_limit, dt)
        middle = pose + (3 * velocity + following) * dt / 8  # constant acceleration, half-way
        next_pose = pose + (velocity + following) * dt / 2
        nearest = jnp.minimum(clearance(scene, middle, jnp), clearance(scene, next_pose, jnp))
        return (next_pose, following), (next_pose, following, nearest)

    rest = jnp.zeros_like(start)
    _, (poses, velocities, nearest) = jax.lax.scan(tick, (start, rest), length=ticks)
    nearest = jnp.minimum(nearest, clearance(scene, start, jnp))
    return jnp.concatenate([start[None], poses]), jnp.concatenate([rest[None], velocities]), nearest
