"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .crouch import (
    PLANAR as PLANAR,
    least_height as least_height,
    speed_lines as speed_lines,
    top_speed as top_speed,
    within_top_speed as within_top_speed,
    without_top_speed as without_top_speed,
)
from .heading import (
    facing as facing,
    pose_error as pose_error,
    turns_freely as turns_freely,
    yaw_between_bounds as yaw_between_bounds,
)
from .scene import (
    BOX_FACES as BOX_FACES,
    POSE_SIZE as POSE_SIZE,
    PoseLike as PoseLike,
    Scene as Scene,
    clearance as clearance,
    make_scene as make_scene,
    obstacle_boxes as obstacle_boxes,
    obstacle_clearances as obstacle_clearances,
    planar_scene as planar_scene,
    without_way_over as without_way_over,
)
from .settings import (
    POSE_NAMES as POSE_NAMES,
    Box as Box,
    BoxSettings as BoxSettings,
    CrouchSettings as CrouchSettings,
    ObstacleSettings as ObstacleSettings,
    SceneSettings as SceneSettings,
    StartSettings as StartSettings,
    TableSettings as TableSettings,
)
from .starts import Starts as Starts, sample_starts as sample_starts
from .tolerance import arrival_time as arrival_time, within_tolerance as within_tolerance
