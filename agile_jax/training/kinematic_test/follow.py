"""The policy in closed loop with a kinematic robot: a point in pose space that accelerates within bounds.

It answers what a mean squared error cannot: whether the field arrives, and whether it hits something on the way. Every
tick of `dt` asks the policy for a velocity and tracks it like the reference of the simulated robot does (tracker.py).

Starts run in blocks of one size, filled up where they are fewer, and each loop ends by itself. So numbers do not depend
on how many starts there are, nor on which run beside which.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.policy.velocity_tracker import track
from agile_jax.scene import POSE_SIZE, Scene, clearance, pose_error

ARRIVED, COLLIDED, STALLED, TIMEOUT = range(4)
OUTCOMES = ("arrived", "collided", "stalled", "timeout")
STALL_SPEED = 0.01  # [m/s] at the end, away from the target
HOLD = 1.0  # [s] within the tolerance, after which a loop ends
BLOCK = 256  # starts at once
CHUNK = 25  # ticks between two looks at whether all have ended


class Followed(NamedTuple):
    """n closed loops of at most K ticks; after its end a robot stands where it was."""

    outcome: np.ndarray  # (n,) int8, index into OUTCOMES; collided prevails
    arrival_time: np.ndarray  # (n,) [s], since when it is within the tolerance for good; infinity when never
    min_clearance: np.ndarray  # (n,) exact, of the torso's box, at the ticks and half-way between them [m]
    final_error: np.ndarray  # (n,) distance of the position to the target [m]
    poses: np.ndarray  # (n, K + 1, 4) [m, rad]

    def rate(self, outcome: int) -> float:
        """The fraction of the starts with this outcome."""
        return float((self.outcome == outcome).mean())


Follower = Callable[[PolicyParameters, np.ndarray, np.ndarray], Followed]  # (parameters, starts (n, 4), limits (n,))


class _Loop(NamedTuple):
    """One robot."""

    pose: jax.Array  # (4,)
    velocity: jax.Array  # (4,)
    nearest: jax.Array  # () least clearance so far [m]
    outside: jax.Array  # () int32, the last tick outside of the tolerance, -1 when none
    ended: jax.Array  # () bool


def make_follower(
    policy: Policy,
    scene: Scene,
    duration: float,
    dt: float = 0.02,
    acceleration_limit: np.ndarray | None = None,
    tolerance: tuple[float, float] = (0.01, 0.03),
) -> Follower:
    """Compile the closed loop once, for any number of starts.

    Args:
        policy: the policy.
        scene: obstacles and target.
        duration: longest time limit [s].
        dt: tick [s].
        acceleration_limit: of the robot, shape (4,) [m/s^2, rad/s^2]; none when not given.
        tolerance: distance [m] and yaw error [rad] that count as arrived.

    Returns:
        (parameters, starts (n, 4) [m, rad], time limits (n,) [s]) -> Followed, from rest at each start.
    """
    limit = jnp.full(POSE_SIZE, np.inf)
    if acceleration_limit is not None:
        limit = jnp.asarray(acceleration_limit, jnp.float32)
    scene = Scene(*(np.asarray(array, np.float32) for array in scene))
    chunks = -(-round(duration / dt) // CHUNK)
    hold = round(HOLD / dt)

    def error(pose: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Distance [m] and yaw error [rad]."""
        difference = pose_error(scene, pose, jnp)
        return jnp.linalg.norm(difference[:3]), jnp.abs(difference[3])

    def outside(pose: jax.Array) -> jax.Array:
        distance, angle = error(pose)
        return ~((distance <= tolerance[0]) & (angle <= tolerance[1]))  # True for NaN

    def begin(start: jax.Array) -> _Loop:
        distance = clearance(scene, start, jnp)
        return _Loop(start, jnp.zeros_like(start), distance, jnp.where(outside(start), 0, -1), jnp.bool_(False))

    def tick(parameters: PolicyParameters, loop: _Loop, number: jax.Array, ticks: jax.Array) -> _Loop:
        """From tick number - 1 to `number`, of `ticks` altogether."""
        wanted = policy.command(parameters, loop.pose, loop.velocity, dt)
        velocity = track(wanted, loop.velocity, limit, dt)
        middle = loop.pose + (3 * loop.velocity + velocity) * dt / 8  # constant acceleration, half-way
        pose = loop.pose + (loop.velocity + velocity) * dt / 2
        nearest = jnp.minimum(clearance(scene, middle, jnp), clearance(scene, pose, jnp))
        last = jnp.where(outside(pose), number, loop.outside)
        ended = (number - last >= hold) | (number >= ticks)
        moved = _Loop(pose, velocity, jnp.minimum(loop.nearest, nearest), last, ended)
        return jax.tree.map(lambda new, old: jnp.where(loop.ended, old, new), moved, loop)

    def run(parameters: PolicyParameters, starts: jax.Array, ticks: jax.Array) -> tuple[_Loop, jax.Array]:
        many = jax.vmap(tick, (None, 0, None, 0))

        def chunk(carry: tuple[jax.Array, _Loop, jax.Array]) -> tuple[jax.Array, _Loop, jax.Array]:
            first, loops, poses = carry

            def one(loops: _Loop, number: jax.Array) -> tuple[_Loop, jax.Array]:
                loops = many(parameters, loops, number, ticks)
                return loops, loops.pose

            loops, visited = jax.lax.scan(one, loops, first + 1 + jnp.arange(CHUNK))
            return first + CHUNK, loops, jax.lax.dynamic_update_slice(poses, visited, (first + 1, 0, 0))

        poses = jnp.broadcast_to(starts, (chunks * CHUNK + 1, *starts.shape))
        first, loops, poses = jax.lax.while_loop(
            lambda carry: (carry[0] < chunks * CHUNK) & ~carry[1].ended.all(),
            chunk,
            (jnp.int32(0), jax.vmap(begin)(starts), poses),
        )
        numbers = jnp.arange(chunks * CHUNK + 1)[:, None, None]
        return loops, jnp.where(numbers <= first, poses, loops.pose)

    compiled = jax.jit(run)
    distances = jax.jit(jax.vmap(error))

    def block(parameters: PolicyParameters, starts: np.ndarray, limits: np.ndarray) -> Followed:
        chosen = np.arange(BLOCK) % len(starts)
        ticks = np.minimum(np.ceil(limits / dt - 1e-6), chunks * CHUNK).astype(np.int32)
        loops, poses = compiled(parameters, jnp.asarray(starts[chosen], jnp.float32), jnp.asarray(ticks[chosen]))
        final_error = np.asarray(distances(loops.pose)[0])
        loops, poses = jax.device_get((loops, poses))
        arrived = ~np.asarray(jax.vmap(outside)(loops.pose))
        speed = np.linalg.norm(loops.velocity[:, :3], axis=-1)
        outcome = np.where(arrived, ARRIVED, np.where(speed < STALL_SPEED, STALLED, TIMEOUT))
        outcome = np.where(loops.nearest < 0, COLLIDED, outcome).astype(np.int8)
        time = np.where(arrived, (loops.outside + 1) * dt, np.inf)
        whole = Followed(outcome, time, loops.nearest, final_error, poses.swapaxes(0, 1))
        return Followed(*(column[: len(starts)] for column in whole))

    def follower(parameters: PolicyParameters, starts: np.ndarray, limits: np.ndarray) -> Followed:
        blocks = [block(parameters, starts[i : i + BLOCK], limits[i : i + BLOCK]) for i in range(0, len(starts), BLOCK)]
        return Followed(*(np.concatenate(columns) for columns in zip(*blocks, strict=True)))

    return follower


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
    """Follow the policy from rest at each start, shape (n, 4), for `duration` [s] at most; see `make_follower`."""
    follower = make_follower(policy, scene, duration, dt, acceleration_limit, tolerance)
    return follower(params, starts, np.full(len(starts), duration))
