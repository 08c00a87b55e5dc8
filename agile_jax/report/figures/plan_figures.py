"""Paths seen from above, from the side and from the front; the paper's figure 2."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D

from agile_jax.report.figures import style
from agile_jax.report.figures.motions import Motion, by_label, timed_poses
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
from agile_jax.scene import Scene

PATH_COLORS = (style.GREEN, style.RED, style.BLUE, style.ORANGE, style.PURPLE)
PATH_DASHES = ("-", (0, (6, 2)), (0, (2, 1.5)), "-.", ":")
PATH = "path"  # group of the lines that are paths
ENVELOPES = 9  # drawn along a path
_SURROUNDINGS = 0.12  # [m] seen around all that is drawn


def draw_plan(ax: Axes, scene: Scene, paths: Motion | Mapping[str, Motion], view: View = "above") -> Axes:
    """Draw obstacles, target and paths in one view, with the torso's envelope at equal intervals of time.

    On axes with paths the scene is not drawn again, and colours go on after those that are there.

    Args:
        ax: is drawn on; `new_axes()` makes one.
        scene: obstacles and target.
        paths: one, or several by label: an expert's trajectory, a recorded episode. The first is green, the second
            red. The legend adds each one's duration.
        view: from above (x, y), from the side (x, z) or from the front (y, z).

    Returns:
        `ax`.
    """
    paths = by_label(paths)
    _draw_view(ax, scene, paths, view)
    style.legend(ax)
    return ax


def _draw_view(ax: Axes, scene: Scene, paths: Mapping[str, Motion], view: View) -> None:
    there = sum(line.get_gid() == PATH for line in ax.lines)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    if not there:
        style.dress(ax)
        if view != "above":
            draw_floor(ax)
        draw_obstacles(ax, scene, view)
        draw_target(ax, scene, view)
    for number, (label, motion) in enumerate(paths.items(), there):
        _draw_path(ax, scene, label, motion, view, number)
    frame(ax, *_extent(scene, paths), view)
    if there:
        ax.set_xlim(min(left, ax.get_xlim()[0]), max(right, ax.get_xlim()[1]))
        ax.set_ylim(min(bottom, ax.get_ylim()[0]), max(top, ax.get_ylim()[1]))


def plan_figure(scene: Scene, paths: Motion | Mapping[str, Motion], title: str = "") -> Figure:
    """The three views of `draw_plan` at one scale, with a legend and a title."""
    paths = by_label(paths)
    low, high = _extent(scene, paths)
    size = high - low
    scale = 7.0 / (size[0] + size[1])  # [inch/m]
    width, height = scale * (size[0] + size[1]) + 1.4, scale * (size[1] + size[2]) + 1.7
    figure = style.new_figure(max(width, 6.0), max(height, 3.5))
    grid = figure.add_gridspec(2, 2, width_ratios=[size[0], size[1]], height_ratios=[size[1], size[2]])
    cells: dict[View, SubplotSpec] = {"above": grid[0, 0], "side": grid[1, 0], "front": grid[1, 1]}
    for view, cell in cells.items():
        ax = figure.add_subplot(cell)
        _draw_view(ax, scene, paths, view)
        ax.set_title(f"from {'' if view == 'above' else 'the '}{view}", fontsize=10, loc="left")
    lines = [_line(number, label, motion) for number, (label, motion) in enumerate(paths.items())]
    lines.append(Line2D([], [], linestyle="", marker="o", color="white", markeredgecolor=style.GREY, label="start"))
    lines.append(Line2D([], [], linestyle="", marker="D", color=style.BLACK, markersize=5, label="target"))
    corner = figure.add_subplot(grid[0, 1])
    corner.axis("off")
    corner.legend(handles=lines, loc="center", fontsize=8.5, frameon=False, handlelength=2.6, labelspacing=1.0)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def _line(number: int, label: str, motion: Motion, columns: tuple[int, int] = (0, 1)) -> Line2D:
    """The line of path `number`; its label ends with the duration."""
    times, poses = timed_poses(motion)
    return Line2D(
        poses[:, columns[0]],
        poses[:, columns[1]],
        color=PATH_COLORS[number % len(PATH_COLORS)],
        linestyle=PATH_DASHES[number % len(PATH_DASHES)],
        linewidth=2.0,
        zorder=5,
        gid=PATH,
        label=f"{label}\n{times[-1] - times[0]:.2f} s".lstrip(),
    )


def _draw_path(ax: Axes, scene: Scene, label: str, motion: Motion, view: View, number: int) -> None:
    times, poses = timed_poses(motion)
    line = _line(number, label, motion, VIEW_AXES[view])
    color = PATH_COLORS[number % len(PATH_COLORS)]
    moments = np.linspace(times[0], times[-1], ENVELOPES)
    for pose in np.stack([np.interp(moments, times, column) for column in poses.T], -1):
        draw_torso(ax, scene, pose, view, color, alpha=0.07)
    ax.add_line(line)
    ax.plot(*poses[0, list(VIEW_AXES[view])], "o", color="white", markeredgecolor=color, markersize=6, zorder=5.5)


def _extent(scene: Scene, paths: Mapping[str, Motion]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Least and greatest coordinates [m] of what is drawn: paths, torso, obstacles and target."""
    reach = np.array([np.hypot(*scene.torso_half_size[:2])] * 2 + [scene.torso_half_size[2]])
    points = [timed_poses(motion)[1][:, :3] for motion in paths.values()]
    cloud = np.concatenate([*points, scene.target[None, :3]])
    low, high = cloud.min(0) - reach, cloud.max(0) + reach
    for center, half, yaw in zip(scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True):
        footprint = box_outline(center, half, float(yaw), "above")
        low = np.minimum(low, [*footprint.min(0), center[2] - half[2]])
        high = np.maximum(high, [*footprint.max(0), center[2] + half[2]])
    low, high = low - _SURROUNDINGS, high + _SURROUNDINGS
    low[2] = -0.06  # a strip of the floor
    return low, high
