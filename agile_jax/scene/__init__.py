"""The scene: obstacles, target, torso envelope, start distribution and exact clearance."""

from agile_jax.scene.heading import facing, pose_error, turns_freely, yaw_between_bounds
from agile_jax.scene.scene import (
    BOX_FACES,
    POSE_SIZE,
    PoseLike,
    Scene,
    clearance,
    make_scene,
    obstacle_boxes,
    obstacle_clearances,
    planar_scene,
)
from agile_jax.scene.settings import (
    POSE_NAMES,
    Box,
    BoxSettings,
    ObstacleSettings,
    SceneSettings,
    StartSettings,
    TableSettings,
)
from agile_jax.scene.starts import Starts, sample_starts
from agile_jax.scene.tolerance import arrival_time, within_tolerance

__all__ = [
    "BOX_FACES",
    "POSE_NAMES",
    "POSE_SIZE",
    "Box",
    "BoxSettings",
    "ObstacleSettings",
    "PoseLike",
    "Scene",
    "SceneSettings",
    "StartSettings",
    "Starts",
    "TableSettings",
    "arrival_time",
    "clearance",
    "facing",
    "make_scene",
    "obstacle_boxes",
    "obstacle_clearances",
    "planar_scene",
    "pose_error",
    "sample_starts",
    "turns_freely",
    "within_tolerance",
    "yaw_between_bounds",
]
