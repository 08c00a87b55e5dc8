"""Joint torques from foot forces and swing paths.

A standing leg applies -J' f, the reaction of the planned ground force. A swinging leg follows its path by joint PD.
Both get the torque that holds the legs' weight and the torque that the joints' own damping and friction would eat:
left out, they are as large as the planned torques themselves (2 Nm s/rad at 4 rad/s).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control.centroidal import GRAVITY
from agile_jax.control.settings import ControlSettings
from agile_jax.control.swing import swing_path
from agile_jax.robot import (
    RobotModel,
    RobotState,
    composite_inertia,
    leg_forward_kinematics,
    leg_inverse_kinematics,
    leg_jacobian,
)

FRICTION_BLEND = 0.3  # joint speed over which dry friction is compensated smoothly [rad/s]
JACOBIAN_DAMPING = 0.02  # of the inverse near a stretched leg [m/rad]


class SwingTarget(NamedTuple):
    """Paths of the four feet; those of standing feet are not used."""

    lift_off_world: jax.Array  # (4, 3) [m]
    foothold_world: jax.Array  # (4, 3) [m]
    step_height: jax.Array  # () [m]
    progress: jax.Array  # (4,) in [0, 1]
    duration: float  # [s]


def gravity_torque(robot: RobotModel, joint_pos: jax.Array, R_world_base: jax.Array) -> jax.Array:
    """Torque that holds the legs' weight with the trunk held: the gradient of potential energy. Shape (12,) [Nm]."""
    up_base = R_world_base[2]

    def energy(q: jax.Array) -> jax.Array:
        mass, center, _ = composite_inertia(robot, q)
        return mass * GRAVITY * jnp.dot(up_base, center)

    return jax.grad(energy)(joint_pos)


def passive_torque(robot: RobotModel, joint_vel: jax.Array) -> jax.Array:
    """Torque that damping and dry friction of the joints take. Shape (12,) [Nm]."""
    return robot.joint_damping * joint_vel + robot.joint_friction * jnp.tanh(joint_vel / FRICTION_BLEND)


def stance_torque(jacobian: jax.Array, forces_base: jax.Array) -> jax.Array:
    """-J' f. Shapes (4, 3, 3), (4, 3) to (12,) [Nm]."""
    return -jnp.einsum("lij,li->lj", jacobian, forces_base).reshape(-1)


def swing_joint_target(
    robot: RobotModel, robot_state: RobotState, R_world_base: jax.Array, jacobian: jax.Array, swing: SwingTarget
) -> tuple[jax.Array, jax.Array]:
    """Joint positions and velocities that follow the feet's paths, shape (12,) each [rad], [rad/s]."""
    position, velocity = swing_path(
        swing.lift_off_world, swing.foothold_world, swing.step_height, swing.progress, swing.duration
    )
    foot_base = (position - robot_state.base_pos) @ R_world_base
    relative = (velocity - robot_state.base_lin_vel_world) @ R_world_base
    relative -= jnp.cross(robot_state.base_ang_vel_base, foot_base)
    joint_pos = leg_inverse_kinematics(robot, foot_base)
    # Damped least squares: near a stretched leg the plain inverse is unbounded.
    gram = jnp.einsum("lij,lkj->lik", jacobian, jacobian) + JACOBIAN_DAMPING**2 * jnp.eye(3)
    joint_vel = jnp.einsum("lji,lj->li", jacobian, jnp.linalg.solve(gram, relative[..., None])[..., 0])
    return joint_pos, joint_vel.reshape(-1)


def whole_body_torque(
    robot: RobotModel,
    settings: ControlSettings,
    robot_state: RobotState,
    R_world_base: jax.Array,
    standing: jax.Array,
    forces_world: jax.Array,
    swing: SwingTarget,
) -> jax.Array:
    """Torques that the planned forces and paths ask of the joints, limits aside. Shape (12,) [Nm].

    Args:
        robot, settings, robot_state: of one robot.
        R_world_base: (3, 3).
        standing: (4,) boolean.
        forces_world: (4, 3) planned forces of the ground on the feet [N].
        swing: the paths of the feet in the air.
    """
    jacobian = leg_jacobian(robot, robot_state.joint_pos)  # (4, 3, 3) base frame
    stance = stance_torque(jacobian, forces_world @ R_world_base)
    target_pos, target_vel = swing_joint_target(robot, robot_state, R_world_base, jacobian, swing)
    pd = settings.swing_stiffness * (target_pos - robot_state.joint_pos)
    pd += settings.swing_damping * (target_vel - robot_state.joint_vel)
    torque = jnp.where(jnp.repeat(standing, 3), stance, pd)
    torque += gravity_torque(robot, robot_state.joint_pos, R_world_base)
    return torque + passive_torque(robot, robot_state.joint_vel)


__all__ = ["SwingTarget", "gravity_torque", "leg_forward_kinematics", "passive_torque", "whole_body_torque"]
