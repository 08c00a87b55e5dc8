"""What is counted while a robot follows a command: errors, extremes, and when it fell."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.benchmark.workloads.commands import Command
from agile_jax.control import Counts
from agile_jax.geometry import quaternion_to_matrix, rotation_2d
from agile_jax.robot import RobotModel, trunk_pose
from agile_jax.simulation import Sensed
from agile_jax.simulation.outcome import LARGEST_SPEED, LARGEST_TILT_COSINE

SETTLING = 1.0  # what is not counted at the beginning [s]


class Tally(NamedTuple):
    """Sums and extremes over the steps of one episode, after the settling time unless said otherwise."""

    fall_time: Float[Array, ""]  # [s], infinity without a fall; over all steps
    steps: Float[Array, ""]
    velocity_error_sq: Float[Array, ""]  # sum, in the plane [m^2/s^2]
    velocity_error: Float[Array, "2"]  # sum, forward and to the left [m/s]
    yaw_rate_error_sq: Float[Array, ""]  # sum [rad^2/s^2]
    height_error_max: Float[Array, ""]  # largest absolute [m]
    tilt_max: Float[Array, ""]  # [rad]
    cone_violation: Float[Array, ""]  # |f_t| - mu f_n of the planned forces, largest over all steps [N]
    torque_share: Float[Array, ""]  # |torque| over its limit, largest over all steps
    joint_violation: Float[Array, ""]  # past a limit, largest over all steps [rad]


def empty_tally() -> Tally:
    """Before the first step."""
    zero = jnp.float32(0.0)
    return Tally(jnp.float32(jnp.inf), zero, zero, jnp.zeros(2), zero, zero, zero, zero, zero, zero)


def update_tally(
    old: Tally,
    time: Float[Array, ""],
    sensed: Sensed,
    command: Command,
    torque: Float[Array, "12"],
    cone_violation: Float[Array, ""],
    robot: RobotModel,
) -> Tally:
    """Count one physics step.

    Args:
        old: so far.
        time: since the start of the episode [s].
        sensed: after the step.
        command: to be followed.
        torque: of the step [Nm].
        cone_violation: of the forces that were planned for the step [N].
        robot: for its limits.
    """
    R = quaternion_to_matrix(sensed.qpos[3:7], jnp)
    finite = jnp.isfinite(sensed.qpos).all() & (jnp.abs(sensed.qvel) < LARGEST_SPEED).all()
    fallen = ~finite | sensed.floor_contact | (R[2, 2] < LARGEST_TILT_COSINE)
    pose = trunk_pose(sensed.qpos, jnp)
    error = sensed.qvel[:2] @ rotation_2d(pose[3], jnp) - command.velocity
    yaw_rate = (R @ sensed.qvel[3:6])[2]
    counted = time >= SETTLING
    share = jnp.abs(torque) / jnp.asarray(robot.torque_limit, jnp.float32)
    joints = sensed.qpos[7:]
    past = jnp.maximum(joints - jnp.asarray(robot.joint_upper), jnp.asarray(robot.joint_lower) - joints)
    new = Tally(
        fall_time=jnp.where(fallen, jnp.minimum(old.fall_time, time), old.fall_time),
        steps=old.steps + counted,
        velocity_error_sq=old.velocity_error_sq + counted * jnp.sum(error**2),
        velocity_error=old.velocity_error + counted * error,
        yaw_rate_error_sq=old.yaw_rate_error_sq + counted * (yaw_rate - command.yaw_rate) ** 2,
        height_error_max=jnp.maximum(old.height_error_max, counted * jnp.abs(pose[2] - command.height)),
        tilt_max=jnp.maximum(old.tilt_max, counted * jnp.arccos(jnp.clip(R[2, 2], -1.0, 1.0))),
        cone_violation=jnp.maximum(old.cone_violation, cone_violation),
        torque_share=jnp.maximum(old.torque_share, share.max()),
        joint_violation=jnp.maximum(old.joint_violation, past.max()),
    )
    return jax.tree.map(lambda after, before: jnp.where(old.fall_time < jnp.inf, before, after), new, old)


def columns(tally: Tally, counts: Counts) -> dict[str, np.ndarray]:
    """One entry an episode: means and extremes from the tallies of n episodes, and the controller's counts."""
    steps = np.maximum(np.asarray(tally.steps), 1)
    found = {
        "fall_time": tally.fall_time,
        "velocity_rms": np.sqrt(np.asarray(tally.velocity_error_sq) / steps),
        "velocity_bias": np.asarray(tally.velocity_error) / steps[:, None],
        "yaw_rate_rms": np.sqrt(np.asarray(tally.yaw_rate_error_sq) / steps),
        "height_error_max": tally.height_error_max,
        "tilt_max": tally.tilt_max,
        "cone_violation": tally.cone_violation,
        "torque_share": tally.torque_share,
        "joint_violation": tally.joint_violation,
        **counts._asdict(),
    }
    return {name: np.asarray(values) for name, values in found.items()}
