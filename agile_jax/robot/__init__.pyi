"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .collision import (
    CollisionShapes as CollisionShapes,
    body_clearance as body_clearance,
    collision_shapes as collision_shapes,
    own_clearance as own_clearance,
)
from .constants import (
    GRAVITY as GRAVITY,
    JOINT_NAMES as JOINT_NAMES,
    LEG_NAMES as LEG_NAMES,
)
from .envelope import check_envelope as check_envelope
from .files import copy_robot as copy_robot, robot_digest as robot_digest
from .kinematics import (
    LinkPoses as LinkPoses,
    composite_inertia as composite_inertia,
    leg_forward_kinematics as leg_forward_kinematics,
    leg_inverse_kinematics as leg_inverse_kinematics,
    leg_jacobian as leg_jacobian,
    link_poses as link_poses,
)
from .model import (
    JOINT_COUNT as JOINT_COUNT,
    LEG_COUNT as LEG_COUNT,
    QPOS_SIZE as QPOS_SIZE,
    QVEL_SIZE as QVEL_SIZE,
    RobotModel as RobotModel,
    RobotState as RobotState,
    load_robot as load_robot,
    robot_state as robot_state,
    trunk_pose as trunk_pose,
)
from .mujoco_model import (
    IMAGE_SIZE as IMAGE_SIZE,
    OBSTACLE_PREFIX as OBSTACLE_PREFIX,
    TOUCH_FLOOR_PREFIX as TOUCH_FLOOR_PREFIX,
    TOUCH_FOOT_PREFIX as TOUCH_FOOT_PREFIX,
    TOUCH_OBSTACLE_PREFIX as TOUCH_OBSTACLE_PREFIX,
    VISUAL_GROUP as VISUAL_GROUP,
    build_mujoco_model as build_mujoco_model,
    standing_qpos as standing_qpos,
)
from .plant import (
    Plant as Plant,
    available_torque as available_torque,
    draw_plants as draw_plants,
    plant_model as plant_model,
)
from .settings import (
    PlantSettings as PlantSettings,
    RobotSettings as RobotSettings,
    SensorSettings as SensorSettings,
)
from .stride import (
    LEAST_LIFT as LEAST_LIFT,
    StrideTable as StrideTable,
    hip_to_foot as hip_to_foot,
    longest_stride as longest_stride,
    lowest_height as lowest_height,
    overshoot as overshoot,
    stride_table as stride_table,
)
