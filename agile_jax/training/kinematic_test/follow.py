"""A kinematic robot follows the policy: a point in pose space that accelerates within bounds.

It answers what a mean squared error cannot: whether the policy arrives, and whether it hits something on the way. Every
tick of `dt` asks it for a velocity and tracks that as the reference of the simulated robot does (velocity_tracker.py).

Starts run in blocks of one size, filled up where they are fewer, and each run ends by itself. So numbers do not depend
on how many starts there are, nor on which run beside which.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32

from agile_jax.policy.kinds import float32_scene
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.policy.velocity_tracker import track
from agile_jax.scene import POSE_SIZE, Scene, clearance, pose_error
from agile_jax.single_precision import in_single_precision

ARRIVED, COLLIDED, STALLED, TIMEOUT = range(4)
OUTCOMES = ("arrived", "collided", "stalled", "timeout")
STALL_SPEED = 0.01  # [m/s] at the end, away from the target
HOLD = 1.0  # [s] within the tolerance, after which a run ends
BLOCK = 256  # starts at once
CHUNK = 25  # ticks between two looks at whether all have ended
TOLERANCE = (0.01, 0.03)  # distance [m] and yaw error [rad] that count as arrived


class Followed(NamedTuple):
    """n runs of at most K ticks; after its end a robot stands where it was."""

    outcome: np.ndarray  # (n,) int8, index into OUTCOMES; collided prevails
    arrival_time: np.ndarray  # (n,) [s], since when it is within the tolerance for good; infinity when never
    min_clearance: np.ndarray  # (n,) exact, of the torso's box, at the ticks and half-way between them [m]
    final_error: np.ndarray  # (n,) distance of the position to the target [m]
    poses: np.ndarray  # (n, K + 1, 4) [m, rad]

    def rate(self, outcome: int) -> float:
        """The fraction of the starts with this outcome."""
        return float((self.outcome == outcome).mean())


class _Robot(NamedTuple):
    """One robot on its way."""

    pose: Float[Array, "*n 4"]  # [m, rad]
    velocity: Float[Array, "*n 4"]  # [m/s, rad/s]
    nearest: Float[Array, "*n"]  # least clearance so far [m]
    outside: Int32[Array, "*n"]  # the last tick outside of the tolerance, -1 when none
    ended: Bool[Array, "*n"]


_Carry = tuple[Int32[Array, ""], _Robot, Float[Array, "ticks n 4"]]


@dataclass(frozen=True, eq=False)
class Follower:
    """Robots that follow a policy from rest, compiled once for any number of them. See `make_follower`.

    Attributes:
        policy: what is followed.
        scene: obstacles and target, float32.
        duration: longest time limit [s].
        dt: tick [s].
        acceleration_limit: of the robot [m/s^2, rad/s^2]; may be infinite.
        tolerance: distance [m] and yaw error [rad] that count as arrived.
    """

    policy: Policy
    scene: Scene
    duration: float
    dt: float
    acceleration_limit: Float[np.ndarray, "4"]
    tolerance: tuple[float, float]

    @in_single_precision
    def __call__(
        self, parameters: PolicyParameters, starts: Float[np.ndarray, "n 4"], limits: Float[np.ndarray, " n"]
    ) -> Followed:
        """Follow from rest at each start [m, rad], each within its time limit [s]."""
        blocks = [
            self._block(parameters, starts[i : i + BLOCK], limits[i : i + BLOCK]) for i in range(0, len(starts), BLOCK)
        ]
        return Followed(*(np.concatenate(columns) for columns in zip(*blocks, strict=True)))

    @property
    def _ticks(self) -> int:
        """The longest run, a multiple of CHUNK."""
        return -(-round(self.duration / self.dt) // CHUNK) * CHUNK

    @cached_property
    def _compiled(self) -> "jax.stages.Wrapped":
        return jax.jit(self._run)

    @cached_property
    def _distances(self) -> "jax.stages.Wrapped":
        return jax.jit(jax.vmap(self._error))

    def _block(
        self, parameters: PolicyParameters, starts: Float[np.ndarray, "n 4"], limits: Float[np.ndarray, " n"]
    ) -> Followed:
        chosen = np.arange(BLOCK) % len(starts)
        ticks = np.minimum(np.ceil(limits / self.dt - 1e-6), self._ticks).astype(np.int32)
        robots, poses = self._compiled(parameters, jnp.asarray(starts[chosen], jnp.float32), jnp.asarray(ticks[chosen]))
        final_error = np.asarray(self._distances(robots.pose)[0])
        robots, poses = jax.device_get((robots, poses))
        arrived = ~np.asarray(jax.vmap(self._outside)(robots.pose))
        speed = np.linalg.norm(robots.velocity[:, :3], axis=-1)
        outcome = np.where(arrived, ARRIVED, np.where(speed < STALL_SPEED, STALLED, TIMEOUT))
        outcome = np.where(robots.nearest < 0, COLLIDED, outcome).astype(np.int8)
        time = np.where(arrived, (robots.outside + 1) * self.dt, np.inf)
        whole = Followed(outcome, time, robots.nearest, final_error, poses.swapaxes(0, 1))
        return Followed(*(column[: len(starts)] for column in whole))

    def _error(self, pose: Float[Array, "4"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Distance to the target [m] and yaw error [rad]."""
        difference = pose_error(self.scene, pose, jnp)
        return jnp.linalg.norm(difference[:3]), jnp.abs(difference[3])

    def _outside(self, pose: Float[Array, "4"]) -> Bool[Array, ""]:
        distance, angle = self._error(pose)
        return ~((distance <= self.tolerance[0]) & (angle <= self.tolerance[1]))  # True for NaN

    def _begin(self, start: Float[Array, "4"]) -> _Robot:
        outside = jnp.where(self._outside(start), jnp.int32(0), jnp.int32(-1))
        return _Robot(start, jnp.zeros_like(start), clearance(self.scene, start, jnp), outside, jnp.bool_(False))

    def _tick(
        self, parameters: PolicyParameters, robot: _Robot, number: Int32[Array, ""], ticks: Int32[Array, ""]
    ) -> _Robot:
        """From tick number - 1 to `number`, of `ticks` altogether."""
        dt, pose, before = self.dt, robot.pose, robot.velocity
        wanted = self.policy.command(parameters, pose, before, dt)
        velocity = track(wanted, before, self.acceleration_limit, dt)
        middle = pose + (3 * before + velocity) * dt / 8  # constant acceleration, half-way
        after = pose + (before + velocity) * dt / 2
        nearest = jnp.minimum(clearance(self.scene, middle, jnp), clearance(self.scene, after, jnp))
        last = jnp.where(self._outside(after), number, robot.outside)
        ended = (number - last >= round(HOLD / dt)) | (number >= ticks)
        moved = _Robot(after, velocity, jnp.minimum(robot.nearest, nearest), last, ended)
        return jax.tree.map(lambda new, old: jnp.where(robot.ended, old, new), moved, robot)

    def _run(
        self, parameters: PolicyParameters, starts: Float[Array, "n 4"], ticks: Int32[Array, " n"]
    ) -> tuple[_Robot, Float[Array, "ticks n 4"]]:
        """The robots at their ends, and their poses at every tick."""
        many, longest = jax.vmap(self._tick, (None, 0, None, 0)), self._ticks

        def chunk(carry: _Carry) -> _Carry:
            first, robots, poses = carry

            def one(robots: _Robot, number: Int32[Array, ""]) -> tuple[_Robot, Float[Array, "n 4"]]:
                robots = many(parameters, robots, number, ticks)
                return robots, robots.pose

            robots, visited = jax.lax.scan(one, robots, first + 1 + jnp.arange(CHUNK, dtype=jnp.int32))
            zero = jnp.int32(0)
            return first + CHUNK, robots, jax.lax.dynamic_update_slice(poses, visited, (first + 1, zero, zero))

        poses = jnp.broadcast_to(starts, (longest + 1, *starts.shape))
        first, robots, poses = jax.lax.while_loop(
            lambda carry: (carry[0] < longest) & ~carry[1].ended.all(),
            chunk,
            (jnp.int32(0), jax.vmap(self._begin)(starts), poses),
        )
        numbers = jnp.arange(longest + 1, dtype=jnp.int32)[:, None, None]
        return robots, jnp.where(numbers <= first, poses, robots.pose)


def make_follower(
    policy: Policy,
    scene: Scene,
    duration: float,
    dt: float = 0.02,
    acceleration_limit: Float[np.ndarray, "4"] | None = None,
    tolerance: tuple[float, float] = TOLERANCE,
) -> Follower:
    """Robots that follow a policy.

    Args:
        policy: what is followed.
        scene: obstacles and target.
        duration: longest time limit [s].
        dt: tick [s].
        acceleration_limit: of the robot [m/s^2, rad/s^2]; none when not given.
        tolerance: distance [m] and yaw error [rad] that count as arrived.
    """
    limit = np.full(POSE_SIZE, np.inf) if acceleration_limit is None else acceleration_limit
    return Follower(policy, float32_scene(scene), duration, dt, np.asarray(limit, np.float32), tolerance)
