"""Planned paths seen from above, from the side and from the front; the paper's figure 2."""

import pathlib
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes

from agile_jax.report.figures.scene_drawing import (
    VIEW_AXES,
    View,
    box_outline,
    draw_floor,
    draw_obstacles,
    draw_target,
    draw_torso,
    frame,
)
from agile_jax.report.figures.style import BLUE, GREEN, ORANGE, PURPLE, RED, dress, new_figure, save
from agile_jax.scene import Scene

PATH_COLORS = (GREEN, RED, BLUE, ORANGE, PURPLE)
PATH_DASHES = ("-", (0, (6, 2)), (0, (2, 1.5)), "-.", ":")
GHOSTS = 9  # torso envelopes drawn along a path
_VIEWS: tuple[View, ...] = ("above", "side", "front")


class Path(Protocol):
    """What is drawn of a trajectory; `expert.Trajectory` is one."""

    @property
    def times(self) -> np.ndarray:
        """Shape (T+1,) [s]."""

    @property
    def states(self) -> np.ndarray:
        """Shape (T+1, 8): pose and rates [m, rad, m/s, rad/s]."""


def draw_plan(scene: Scene, trajectories: Mapping[str, Path], path: pathlib.Path, title: str = "") -> pathlib.Path:
    """Draw paths from above, from the side and from the front, with the torso's envelope at equal intervals of time.

    Args:
        scene: obstacles and target.
        trajectories: by label; the legend adds each one's duration. The first is green, the second red.
        path: of the PNG.
        title: over the figure.

    Returns:
        `path`.
    """
    low, high = _extent(scene, trajectories)
    size = high - low
    scale = 7.0 / (size[0] + size[1])  # [inch/m]
    width, height = scale * (size[0] + size[1]) + 1.4, scale * (size[1] + size[2]) + 1.7
    figure = new_figure(max(width, 6.0), max(height, 3.5))
    grid = figure.add_gridspec(2, 2, width_ratios=[size[0], size[1]], height_ratios=[size[1], size[2]])
    cells = {"above": grid[0, 0], "side": grid[1, 0], "front": grid[1, 1]}
    handles = []
    for view in _VIEWS:
        axes = dress(figure.add_subplot(cells[view]), title=f"from {'the ' if view != 'above' else ''}{view}")
        if view != "above":
            draw_floor(axes)
        draw_obstacles(axes, scene, view)
        handles = _draw_paths(axes, scene, trajectories, view)
        draw_target(axes, scene, view)
        frame(axes, low, high, view)
    corner = figure.add_subplot(grid[0, 1])
    corner.axis("off")
    corner.legend(handles=handles, loc="center", fontsize=8.5, frameon=False, handlelength=2.6, labelspacing=1.0)
    if title:
        figure.suptitle(title, fontsize=11)
    return save(figure, path)


def _draw_paths(axes: Axes, scene: Scene, trajectories: Mapping[str, Path], view: View) -> list[Any]:
    """Draw every path in one view; returns the legend's handles."""
    columns = VIEW_AXES[view]
    handles = []
    for number, (label, trajectory) in enumerate(trajectories.items()):
        color, dash = PATH_COLORS[number % len(PATH_COLORS)], PATH_DASHES[number % len(PATH_DASHES)]
        times, poses = np.asarray(trajectory.times), np.asarray(trajectory.states)[:, :4]
        moments = np.linspace(times[0], times[-1], GHOSTS)
        for pose in np.stack([np.interp(moments, times, column) for column in poses.T], -1):
            draw_torso(axes, scene, pose, view, color, alpha=0.07)
        text = f"{label}\n{times[-1] - times[0]:.2f} s"
        handles += axes.plot(
            poses[:, columns[0]], poses[:, columns[1]], color=color, linestyle=dash, linewidth=2.0, zorder=5, label=text
        )
        axes.plot(*poses[0, list(columns)], "o", color="white", markeredgecolor=color, markersize=6, zorder=5.5)
    handles += axes.plot([], [], "o", color="white", markeredgecolor="#444444", markersize=6, label="start")
    handles += axes.plot([], [], "D", color="#222222", markersize=5, label="target")
    return handles


def _extent(scene: Scene, trajectories: Mapping[str, Path]) -> tuple[np.ndarray, np.ndarray]:
    """The part of space (3,), (3,) [m] that holds paths, torso, obstacles and target."""
    reach = np.array([np.hypot(*scene.torso_half_size[:2])] * 2 + [scene.torso_half_size[2]])
    points = [np.asarray(trajectory.states)[:, :3] for trajectory in trajectories.values()]
    cloud = np.concatenate([*points, scene.target[None, :3]])
    low, high = cloud.min(0) - reach, cloud.max(0) + reach
    for center, half, yaw in zip(scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True):
        footprint = box_outline(center, half, float(yaw), "above")
        low = np.minimum(low, [*footprint.min(0), center[2] - half[2]])
        high = np.maximum(high, [*footprint.max(0), center[2] + half[2]])
    low, high = low - 0.12, high + 0.12
    low[2] = -0.06
    return low, high
