"""The robot's constants as arrays, and its state."""

from types import ModuleType
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from agile_jax.arrays import AnyArray
from agile_jax.geometry import quaternion_to_matrix, quaternion_to_rpy
from agile_jax.robot import constants
from agile_jax.robot.leg_shape import LegShape, leg_shape
from agile_jax.robot.mjcf import robot_spec
from agile_jax.robot.settings import RobotSettings

LEG_COUNT = len(constants.LEG_NAMES)
JOINT_COUNT = LEG_COUNT * len(constants.JOINT_NAMES)
LINK_COUNT = 1 + JOINT_COUNT
HOME_CROUCH = 0.675  # height over leg length of the home posture, where a file has no keyframe; the A1's
QPOS_SIZE = 7 + JOINT_COUNT
QVEL_SIZE = 6 + JOINT_COUNT


class RobotModel(NamedTuple):
    """Constants of a quadruped with abad (x), hip (y) and knee (y) joints. Legs FR, FL, RR, RL. SI units.

    The base frame is the trunk's: x forward, y left, z up, origin midway between the abad axes.
    Links are the trunk, then hip, thigh and calf (with foot) of each leg.
    """

    hip_pos_base: Float[AnyArray, "4 3"]  # the abad axis [m]
    abad_offset: Float[AnyArray, "4"]  # along y from the abad axis to the plane of the leg [m]
    thigh_length: float  # [m]
    calf_length: float  # knee to foot centre [m]
    foot_radius: float  # [m]
    joint_lower: Float[AnyArray, "12"]  # [rad]
    joint_upper: Float[AnyArray, "12"]  # [rad]
    torque_limit: Float[AnyArray, "12"]  # [Nm]
    joint_damping: Float[AnyArray, "12"]  # passive torque per speed [Nm s/rad]
    joint_armature: Float[AnyArray, "12"]  # [kg m^2]
    joint_friction: Float[AnyArray, "12"]  # dry friction [Nm]
    foot_friction: float  # coefficient
    link_masses: Float[AnyArray, "13"]  # [kg]
    link_coms: Float[AnyArray, "13 3"]  # in the link's frame [m]
    link_inertias: Float[AnyArray, "13 3 3"]  # about the link's centre of mass, along its axes [kg m^2]
    home_joint_pos: Float[AnyArray, "12"]  # [rad]
    nominal_height: float  # of the base's origin over the floor [m]
    shape: LegShape  # of what collides


class RobotState(NamedTuple):
    """State of the robot, in MuJoCo's conventions."""

    base_pos: Float[AnyArray, "*batch 3"]  # of the trunk's origin in the world [m]
    base_quat: Float[AnyArray, "*batch 4"]  # world from base, wxyz
    base_lin_vel_world: Float[AnyArray, "*batch 3"]  # of the trunk's origin [m/s]
    base_ang_vel_base: Float[AnyArray, "*batch 3"]  # [rad/s]
    joint_pos: Float[AnyArray, "*batch 12"]  # [rad]
    joint_vel: Float[AnyArray, "*batch 12"]  # [rad/s]
    foot_contact: Bool[AnyArray, "*batch 4"] | None = None  # what the feet touch; None where they cannot feel

    def pose(self, xp: ModuleType = np) -> Float[AnyArray, "*batch 4"]:
        """[x, y, z, yaw] of the trunk [m, rad]."""
        return trunk_pose(xp.concatenate([self.base_pos, self.base_quat], -1), xp)


def load_robot(settings: RobotSettings) -> RobotModel:
    """The robot that `settings` name, in float64.

    Raises:
        BadInput: its MJCF cannot be used; with the reason.
    """
    model = robot_spec(settings).compile()
    links = range(1, 1 + LINK_COUNT)
    axes = quaternion_to_matrix(model.body_iquat[links])
    inertias = np.einsum("bij,bj,bkj->bik", axes, model.body_inertia[links], axes)
    thigh = [model.body(f"{leg}_thigh").pos for leg in constants.LEG_NAMES]
    feet = [model.geom(f"{leg}_foot") for leg in constants.LEG_NAMES]
    thigh_length = float(-np.mean([model.body(f"{leg}_calf").pos[2] for leg in constants.LEG_NAMES]))
    calf_length = float(-np.mean([foot.pos[2] for foot in feet]))
    nominal_height = HOME_CROUCH * (thigh_length + calf_length)
    home_joint_pos = np.tile(home_angles(thigh_length, calf_length, nominal_height - float(feet[0].size[0])), LEG_COUNT)
    if model.nkey:
        nominal_height, home_joint_pos = float(model.key_qpos[0, 2]), model.key_qpos[0, 7:QPOS_SIZE].copy()
    return RobotModel(
        hip_pos_base=np.array([model.body(f"{leg}_hip").pos for leg in constants.LEG_NAMES]),
        abad_offset=np.array([pos[1] for pos in thigh]),
        thigh_length=thigh_length,
        calf_length=calf_length,
        foot_radius=float(feet[0].size[0]),
        joint_lower=model.jnt_range[1:, 0].copy(),
        joint_upper=model.jnt_range[1:, 1].copy(),
        torque_limit=model.actuator_ctrlrange[:, 1].copy(),
        joint_damping=model.dof_damping[6:].copy(),
        joint_armature=model.dof_armature[6:].copy(),
        joint_friction=model.dof_frictionloss[6:].copy(),
        foot_friction=float(feet[0].friction[0]),
        link_masses=model.body_mass[links].copy(),
        link_coms=model.body_ipos[links].copy(),
        link_inertias=inertias,
        home_joint_pos=home_joint_pos,
        nominal_height=nominal_height,
        shape=leg_shape(model),
    )


def home_angles(thigh_length: float, calf_length: float, depth: float) -> list[float]:
    """Abad, hip and knee with the foot straight below the hip by `depth` [m]."""
    cosine = (depth**2 - thigh_length**2 - calf_length**2) / (2 * thigh_length * calf_length)
    knee = -np.arccos(np.clip(cosine, -1.0, 1.0))
    return [0.0, -np.arctan2(calf_length * np.sin(knee), thigh_length + calf_length * np.cos(knee)), knee]


def trunk_pose(qpos: Float[AnyArray, "*batch nq"], xp: ModuleType = np) -> Float[AnyArray, "*batch 4"]:
    """[x, y, z, yaw] of the trunk at coordinates, the robot's first [m, rad]."""
    return xp.concatenate([qpos[..., :3], quaternion_to_rpy(qpos[..., 3:7], xp)[..., 2:]], -1)


def robot_state(
    qpos: Float[AnyArray, "*batch nq"],
    qvel: Float[AnyArray, "*batch nv"],
    foot_contact: Bool[AnyArray, "*batch 4"] | None = None,
) -> RobotState:
    """Split MuJoCo's coordinates and velocities, the robot's first, into its state."""
    return RobotState(
        base_pos=qpos[..., :3],
        base_quat=qpos[..., 3:7],
        base_lin_vel_world=qvel[..., :3],
        base_ang_vel_base=qvel[..., 3:6],
        joint_pos=qpos[..., 7:QPOS_SIZE],
        joint_vel=qvel[..., 6:QVEL_SIZE],
        foot_contact=foot_contact,
    )
