"""The robot: its constants with sources, kinematics in JAX, and the MuJoCo model of the robot in its scene."""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names
from agile_jax.robot.constants import FRONT, GRAVITY, JOINT_NAMES, LEFT, LEG_NAMES
from agile_jax.robot.settings import RobotSettings

if TYPE_CHECKING:
    from agile_jax.robot.collision import CollisionShapes, body_clearance, collision_shapes
    from agile_jax.robot.envelope import check_envelope
    from agile_jax.robot.files import copy_robot, robot_digest
    from agile_jax.robot.kinematics import (
        LinkPoses,
        composite_inertia,
        leg_forward_kinematics,
        leg_inverse_kinematics,
        leg_jacobian,
        link_poses,
    )
    from agile_jax.robot.model import (
        JOINT_COUNT,
        LEG_COUNT,
        QPOS_SIZE,
        QVEL_SIZE,
        RobotModel,
        RobotState,
        load_robot,
        robot_state,
    )
    from agile_jax.robot.mujoco_model import (
        IMAGE_SIZE,
        OBSTACLE_PREFIX,
        TOUCH_FLOOR_PREFIX,
        TOUCH_FOOT_PREFIX,
        TOUCH_OBSTACLE_PREFIX,
        VISUAL_GROUP,
        build_mujoco_model,
        standing_qpos,
    )

__all__ = [
    "FRONT",
    "GRAVITY",
    "IMAGE_SIZE",
    "JOINT_COUNT",
    "JOINT_NAMES",
    "LEFT",
    "LEG_COUNT",
    "LEG_NAMES",
    "OBSTACLE_PREFIX",
    "QPOS_SIZE",
    "QVEL_SIZE",
    "TOUCH_FLOOR_PREFIX",
    "TOUCH_FOOT_PREFIX",
    "TOUCH_OBSTACLE_PREFIX",
    "VISUAL_GROUP",
    "CollisionShapes",
    "LinkPoses",
    "RobotModel",
    "RobotSettings",
    "RobotState",
    "body_clearance",
    "build_mujoco_model",
    "check_envelope",
    "collision_shapes",
    "composite_inertia",
    "copy_robot",
    "leg_forward_kinematics",
    "leg_inverse_kinematics",
    "leg_jacobian",
    "link_poses",
    "load_robot",
    "robot_digest",
    "robot_state",
    "standing_qpos",
]

__getattr__ = lazy_names(
    __name__,
    {
        "collision": "CollisionShapes body_clearance collision_shapes",
        "envelope": "check_envelope",
        "files": "copy_robot robot_digest",
        "kinematics": (
            "LinkPoses composite_inertia leg_forward_kinematics leg_inverse_kinematics leg_jacobian link_poses"
        ),
        "model": "JOINT_COUNT LEG_COUNT QPOS_SIZE QVEL_SIZE RobotModel RobotState load_robot robot_state",
        "mujoco_model": (
            "IMAGE_SIZE OBSTACLE_PREFIX TOUCH_FLOOR_PREFIX TOUCH_FOOT_PREFIX TOUCH_OBSTACLE_PREFIX VISUAL_GROUP "
            "build_mujoco_model standing_qpos"
        ),
    },
)
