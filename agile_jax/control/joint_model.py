"""What the joints really take, learned while the robot walks: damping, dry friction and inertia of the rotors.

The robot's file says what these are; of a real one, or of another engine's, they differ by factors. While a leg is in
the air, no force but known ones acts on it, and Lagrange's equation holds for the momentum p = dT/dq' of its joints,

    p(t) - p(0) + a (q'(t) - q'(0)) = int tau + dL/dq - d q' - f sgn(q') dt,

with T and L = T - V those of the links without rotors at the measured motion of the trunk. This is linear in rotor
inertia a, damping d and friction f. Least squares over the windows between two plans, of all legs in the air, give the
three for each joint of a leg, in float32, without accelerations: integrated over a window, noise of measured
velocities counts at its two ends only. The file's values are the prior: where joints hardly move, they stay. A file
that calls its joints ideal is not believed to the letter.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from agile_jax.geometry import inverse_3x3, quaternion_to_matrix
from agile_jax.robot import GRAVITY, LEG_COUNT, RobotModel, RobotState, link_poses

RANGE = 4.0  # the estimates stay below so many standard deviations of the prior, and are never negative
# Least standard deviations of the prior for rotor inertia [s^2], damping [s], friction [-], over the joint's torque
# limit: what the A1's joints have. Where the file has more, that is the standard deviation.
LEAST_SPREAD = (3e-4, 0.03, 0.006)
TORQUE_ERROR = 0.03  # standard deviation of what the equation leaves out, over the joint's torque limit
MEMORY = 2.0  # of walking, after which an observation counts 1 / e [s]
FRICTION_BLEND = 0.3  # joint speed over which dry friction sets in [rad/s]
END_STOP = 0.02  # nearer to a joint's limit than this, the stop may push [rad]


class Window(NamedTuple):
    """What has been measured since the last plan."""

    momentum: Float[Array, "12"]  # of the joints at its begin, without rotors [Nm s]
    slope: Float[Array, "12"]  # dL/dq at its begin [Nm]
    joint_pos: Float[Array, "12"]  # at its begin [rad]
    joint_vel: Float[Array, "12"]  # at its begin [rad/s]
    impulse: Float[Array, "12"]  # of the torques since then [Nm s]
    direction: Float[Array, "12"]  # integral of the joints' directions since then [s]
    free: Bool[Array, "4"]  # the leg has touched nothing since then


class JointModel(NamedTuple):
    """What has been learned of the joints abad, hip, knee, for rotor inertia, damping, friction: normal equations."""

    information: Float[Array, "3 3 3"]
    moment: Float[Array, "3 3"]  # of what the prior does not explain
    armature: Float[Array, "12"]  # [kg m^2]
    damping: Float[Array, "12"]  # [Nm s/rad]
    friction: Float[Array, "12"]  # [Nm]
    window: Window

    def told(self, robot: RobotModel) -> RobotModel:
        """The robot with these joints."""
        return robot._replace(joint_armature=self.armature, joint_damping=self.damping, joint_friction=self.friction)


def direction(joint_vel: Float[Array, "12"]) -> Float[Array, "12"]:
    """The sign of a velocity, smooth at zero."""
    return jnp.tanh(joint_vel / FRICTION_BLEND)


def passive_torque(robot: RobotModel, joint_vel: Float[Array, "12"]) -> Float[Array, "12"]:
    """Torque that damping and dry friction of the joints take [Nm]."""
    return robot.joint_damping * joint_vel + robot.joint_friction * direction(joint_vel)


def nothing_learned(robot: RobotModel, robot_state: RobotState) -> JointModel:
    """Before the first step."""
    zero = jnp.zeros(12)
    window = Window(zero, zero, robot_state.joint_pos, robot_state.joint_vel, zero, zero, jnp.zeros(LEG_COUNT, bool))
    armature, damping, friction = jnp.asarray(_by_joint(robot).reshape(3, 12))
    return JointModel(jnp.zeros((3, 3, 3)), jnp.zeros((3, 3)), armature, damping, friction, window)


def _estimate(
    robot: RobotModel, information: Float[Array, "3 3 3"], moment: Float[Array, "3 3"]
) -> Float[Array, "3 12"]:
    """Rotor inertia, damping and friction of all joints that explain best what has been seen."""
    prior, limit = (
        _by_joint(robot),
        np.asarray(robot.torque_limit, np.float32).reshape(LEG_COUNT, 3),
    )  # (parameter, leg, joint)
    spread = np.maximum(prior, np.asarray(LEAST_SPREAD, np.float32)[:, None, None] * limit)
    noise = TORQUE_ERROR * limit.mean(0)[:, None]
    # In units of the prior's deviation and of the noise the prior's information is the unit matrix.
    scale = spread.mean(1).T / noise  # (joint, parameter)
    whole = information * scale[:, :, None] * scale[:, None, :] + jnp.eye(3)
    shift = jnp.einsum("jab,jb->aj", inverse_3x3(whole, jnp), moment * scale / noise)[:, None] * spread
    return jnp.clip(prior + shift, 0.0, RANGE * spread).reshape(3, 12)


def record(
    model: JointModel, robot_state: RobotState, torque: Float[Array, "12"], free: Bool[Array, "4"], dt: float
) -> JointModel:
    """Add a command to the window: the torque [Nm] of the next `dt` [s]; `free` are the legs in the air."""
    window = model.window
    window = window._replace(
        impulse=window.impulse + dt * torque,
        direction=window.direction + dt * direction(robot_state.joint_vel),
        free=window.free & free,
    )
    return model._replace(window=window)


def learn(
    robot: RobotModel, model: JointModel, robot_state: RobotState, free: Bool[Array, "4"], dt: float
) -> JointModel:
    """Close the window of `dt` [s], and begin the next.

    Args:
        robot: as its file says.
        model: so far.
        robot_state: measured.
        free: legs in the air now.
        dt: of the window.
    """
    window = model.window
    momentum, slope = joint_momentum(robot, robot_state)
    before, now = window.joint_pos, robot_state.joint_pos
    regressor = jnp.stack([robot_state.joint_vel - window.joint_vel, now - before, window.direction])
    rest = window.impulse + dt * (slope + window.slope) / 2 - (momentum - window.momentum)
    prior = jnp.asarray(_by_joint(robot).reshape(3, 12))
    rest -= jnp.sum(prior * regressor, 0)
    inside = (jnp.minimum(before, now) > robot.joint_lower + END_STOP) & (
        jnp.maximum(before, now) < robot.joint_upper - END_STOP
    )
    used = (window.free & free)[:, None] & inside.reshape(LEG_COUNT, 3)
    seen = (regressor / dt).reshape(3, LEG_COUNT, 3) * used  # means over the window
    rest = (rest / dt).reshape(LEG_COUNT, 3) * used
    keep = jnp.where(used.any(0), jnp.exp(-dt / MEMORY), 1.0)[:, None]
    following = Window(momentum, slope, now, robot_state.joint_vel, jnp.zeros(12), jnp.zeros(12), free)
    information = keep[..., None] * model.information + jnp.einsum("alj,blj->jab", seen, seen)
    moment = keep * model.moment + jnp.einsum("alj,lj->ja", seen, rest)
    armature, damping, friction = _estimate(robot, information, moment)
    return JointModel(information, moment, armature, damping, friction, following)


def top_speed(robot: RobotModel, height: Float[Array, ""], duty: Float[Array, ""]) -> Float[Array, ""]:
    """The speed at which damping and friction of the hips take all their torque [m/s].

    Seen from a hip that goes at speed v, a foot in the air moves by (6 s (1 - s) / (1 - duty) - 1) v, s its progress,
    and below the hip at depth D the joint turns by that over D: over the swing, by the root mean square
    sqrt(1.2 / (1 - duty)^2 - 2 / (1 - duty) + 1) v / D. A leg that cannot falls behind, and its knee then rises.

    Args:
        robot: with the joints as they are believed to be.
        height: of the trunk [m].
        duty: share of the period that a foot stands [-].
    """
    left = jnp.asarray(robot.torque_limit)[1::3] - robot.joint_friction[1::3]
    turning = (left / jnp.maximum(robot.joint_damping[1::3], 1e-3)).min()
    swing = 1 / (1 - duty)
    depth = jnp.maximum(height - robot.foot_radius, 0.0)
    return turning * depth / jnp.sqrt(1.2 * swing**2 - 2 * swing + 1)


def joint_momentum(robot: RobotModel, robot_state: RobotState) -> tuple[Float[Array, "12"], Float[Array, "12"]]:
    """The momentum dT/dq' of the joints [Nm s] and the slope dL/dq [Nm], both without rotors."""
    R = quaternion_to_matrix(robot_state.base_quat, jnp)
    velocity, spin = R.T @ robot_state.base_lin_vel_world, robot_state.base_ang_vel_base
    masses, inertias = jnp.asarray(robot.link_masses), jnp.asarray(robot.link_inertias)

    def place(q: jax.Array) -> tuple[jax.Array, jax.Array]:
        poses = link_poses(robot, q)
        return poses.pos + jnp.einsum("bij,bj->bi", poses.rotation, robot.link_coms), poses.rotation

    def lagrangian(q: jax.Array, joint_vel: jax.Array) -> jax.Array:
        (center, rotation), (slide, turn) = jax.jvp(place, (q,), (joint_vel,))
        linear = velocity + jnp.cross(spin, center) + slide
        own = jnp.einsum("bji,bjk->bik", rotation, turn)  # the skew matrix of the turning, in the link's axes
        angular = jnp.stack([own[:, 2, 1], own[:, 0, 2], own[:, 1, 0]], -1) + spin @ rotation
        kinetic = jnp.sum(masses * jnp.sum(linear**2, -1)) + jnp.einsum("bi,bij,bj->", angular, inertias, angular)
        return kinetic / 2 - GRAVITY * masses @ (center @ R[2])

    slope, momentum = jax.grad(lagrangian, (0, 1))(robot_state.joint_pos, robot_state.joint_vel)
    return momentum, slope


def _by_joint(robot: RobotModel) -> Float[np.ndarray, "3 4 3"]:
    """Rotor inertia, damping and friction by leg and joint, as the file says."""
    values = robot.joint_armature, robot.joint_damping, robot.joint_friction
    return np.stack([np.asarray(value, np.float32) for value in values]).reshape(3, LEG_COUNT, 3)
