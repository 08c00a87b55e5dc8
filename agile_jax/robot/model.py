"""The robot's constants as arrays, and its state."""

from typing import Any, NamedTuple

import numpy as np

from agile_jax.robot import constants
from agile_jax.robot.settings import RobotSettings

Array = Any  # numpy.ndarray or jax.Array

LEG_COUNT = len(constants.LEG_NAMES)
JOINT_COUNT = LEG_COUNT * len(constants.JOINT_NAMES)
QPOS_SIZE = 7 + JOINT_COUNT
QVEL_SIZE = 6 + JOINT_COUNT


class RobotModel(NamedTuple):
    """Constants of a quadruped with abad (x), hip (y) and knee (y) joints. Legs FR, FL, RR, RL. SI units.

    The base frame is the trunk's: x forward, y left, z up, origin midway between the abad axes.
    Links are the trunk, then hip, thigh and calf (with foot) of each leg.
    """

    hip_pos_base: Array  # (4, 3) the abad axis [m]
    abad_offset: Array  # (4,) along y from the abad axis to the plane of the leg [m]
    thigh_length: float  # [m]
    calf_length: float  # knee to foot centre [m]
    foot_radius: float  # [m]
    joint_lower: Array  # (12,) [rad]
    joint_upper: Array  # (12,) [rad]
    torque_limit: Array  # (12,) [Nm]
    velocity_limit: Array  # (12,) [rad/s]
    joint_damping: Array  # (12,) passive torque per speed [Nm s/rad]
    joint_armature: Array  # (12,) [kg m^2]
    joint_friction: Array  # (12,) dry friction [Nm]
    foot_friction: float  # coefficient
    link_masses: Array  # (13,) [kg]
    link_coms: Array  # (13, 3) in the link's frame [m]
    link_inertias: Array  # (13, 3, 3) about the link's centre of mass, along its axes [kg m^2]
    home_joint_pos: Array  # (12,) [rad]
    nominal_height: float  # of the base's origin over the floor [m]


class RobotState(NamedTuple):
    """State of the robot, in MuJoCo's conventions."""

    base_pos: Array  # (3,) of the trunk's origin in the world [m]
    base_quat: Array  # (4,) world from base, wxyz
    base_lin_vel_world: Array  # (3,) of the trunk's origin [m/s]
    base_ang_vel_base: Array  # (3,) [rad/s]
    joint_pos: Array  # (12,) [rad]
    joint_vel: Array  # (12,) [rad/s]
    foot_contact: Array | None = None  # (4,) bool: what the feet touch; None where they cannot feel


def load_robot(settings: RobotSettings) -> RobotModel:
    """The robot that `settings` name, in float64."""
    links = constants.links()
    inertias = [[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] for xx, yy, zz, xy, xz, yz in (k.inertia for k in links)]
    return RobotModel(
        hip_pos_base=constants.HIP_POS_BASE,
        abad_offset=constants.ABAD_OFFSET,
        thigh_length=constants.THIGH_LENGTH,
        calf_length=constants.CALF_LENGTH,
        foot_radius=constants.FOOT_RADIUS,
        joint_lower=constants.JOINT_LOWER,
        joint_upper=constants.JOINT_UPPER,
        torque_limit=constants.TORQUE_LIMIT,
        velocity_limit=constants.VELOCITY_LIMIT,
        joint_damping=constants.JOINT_DAMPING,
        joint_armature=constants.JOINT_ARMATURE,
        joint_friction=constants.JOINT_FRICTION,
        foot_friction=constants.FOOT_FRICTION,
        link_masses=np.array([k.mass for k in links]),
        link_coms=np.array([k.com for k in links]),
        link_inertias=np.array(inertias),
        home_joint_pos=constants.HOME_JOINT_POS,
        nominal_height=constants.NOMINAL_HEIGHT,
    )


def robot_state(qpos: Array, qvel: Array, foot_contact: Array | None = None) -> RobotState:
    """Split MuJoCo's coordinates (19,) and velocities (18,) of the robot; leading batch axes are kept."""
    return RobotState(
        base_pos=qpos[..., :3],
        base_quat=qpos[..., 3:7],
        base_lin_vel_world=qvel[..., :3],
        base_ang_vel_base=qvel[..., 3:6],
        joint_pos=qpos[..., 7:QPOS_SIZE],
        joint_vel=qvel[..., 6:QVEL_SIZE],
        foot_contact=foot_contact,
    )
