"""Settings of the expert: bounds, margins, transcription, and where its labels start."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from agile_jax.scene.settings import SceneSettings
from agile_jax.settings import Count, Fraction, NonNegative, Pose, Positive, PositivePose, Settings


class ExpertSettings(Settings):
    """The optimal control problem of the paper (equation 2), its transcription, and the starts of its labels.

    The paper gives no bounds, no margin and no effort weight. The defaults are what a trotting A1 can track. Rates
    and accelerations are of [x, y, z, yaw].
    """

    trajectories: Count = 400
    # Poses [m, rad] that the labels lead to, in turn: label i to number i modulo their count; the scene's if none.
    targets: Annotated[tuple[Pose, ...], Field(strict=False)] = ()
    nodes: Annotated[int, Field(ge=10, le=2000)] = 100  # intervals of a trajectory
    shard_size: Count = 50  # trajectories in a file
    velocity: PositivePose = (1.0, 0.5, 0.3, 1.0)  # bounds [m/s, rad/s]
    acceleration: PositivePose = (1.5, 1.5, 1.0, 3.0)  # bounds [m/s^2, rad/s^2]
    clearance_margin: NonNegative = 0.025  # epsilon of equation 2 [m]
    initial_velocity: Literal["rest", "free"] = "rest"  # rest: the paper; free: the best one within the bounds
    # Weight of the integral of sum (u_i / a_i)^2 in the objective [-]; makes labels unique (expert/__init__.py).
    effort_weight: Annotated[float, Field(gt=0, le=1)] = 5e-3
    # Piecewise-constant acceleration, piecewise-linear acceleration (Hermite-Simpson), trapezoidal collocation.
    transcription: Literal["zoh", "foh", "trapezoidal"] = "zoh"
    # axis: |v_i| <= velocity_i; planar_norm: in the plane (v_x / velocity_x)^2 + (v_y / velocity_y)^2 <= 1.
    velocity_bound: Literal["axis", "planar_norm"] = "axis"
    zero_end_controls: bool = False  # the paper's u_0 = u_N = 0; costs 2 / nodes of the time, 1 / nodes if not zoh
    planner: Literal["3d", "2d"] = "3d"  # 2d: height fixed at the target's, obstacles from the floor up (figure 2)
    # auto: closed-form least time where it is attained, else the general program; general: always the program.
    method: Literal["auto", "general"] = "auto"
    # Around obstacles' edges the general program keeps the margin exactly (rounded), or stays within the fast path's
    # square corners, whose diagonal is up to sqrt(2) margins away.
    edges: Literal["rounded", "square"] = "rounded"
    max_routes: Count = 24  # routes solved by the general program for one start at most
    starts: Literal["paper", "wide"] = "paper"  # paper: scene.start; wide: dataset/starts.py
    wide_paper_fraction: Fraction = 0.35  # of the wide starts, drawn as the paper's but at any height
    wide_target_fraction: Fraction = 0.15  # of the wide starts, drawn around the target
    wide_target_std: Positive = 0.4  # of those, in the plane [m]
    wide_yaw_std: NonNegative = 0.4  # around the target's yaw [rad]
    wide_padding: NonNegative = 0.5  # of the box around starts, obstacles and target [m]


def check_scene(scene: SceneSettings, settings: ExpertSettings) -> None:
    """Refuse targets out of bounds or with less than the margin (BadInput, which names the one): no plan could end
    there."""
    from agile_jax.expert.feasible_poses import check_target
    from agile_jax.scene.scene import make_scene

    made = make_scene(scene)
    check_target(made, settings)
    for i, target in enumerate(settings.targets):
        check_target(made, settings, np.array(target), f"expert.targets[{i}]")
