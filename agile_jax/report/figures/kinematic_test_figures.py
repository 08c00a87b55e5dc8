"""Figures of the kinematic test: where the field errs, from where it arrives how late, and its worst paths."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from agile_jax.report.figures import style
from agile_jax.report.figures.scene_drawing import AXIS_LABELS, VIEW_AXES, View, draw_obstacles, draw_target
from agile_jax.report.reading import KinematicTest
from agile_jax.scene import Scene
from agile_jax.training.kinematic_test.follow import ARRIVED, OUTCOMES

FAILED_LOOKS = {"collided": (style.RED, "X"), "stalled": (style.ORANGE, "v"), "timeout": (style.PURPLE, "s")}
CELLS = 60  # hexagons across an error map
ROOM = 0.3  # [m] around all that is drawn
_VIEWS: tuple[View, View] = ("above", "side")
_TAILS = (0.01, 0.99)  # quantiles between which colours tell values apart
Range: TypeAlias = tuple[float, float]


def arrivals_figure(scene: Scene, test: KinematicTest) -> Figure:
    """Starts by their arrival time over the expert's, failures marked; and the distribution of these times."""
    figure = style.new_figure(9.0, 4.2)
    left, right = figure.subplots(1, 2, width_ratios=[1.6, 1.0])
    draw_arrivals(left, scene, test)
    draw_arrival_times(right, test)
    return figure


def draw_arrivals(ax: Axes, scene: Scene, test: KinematicTest) -> Axes:
    """Starts in the plane, coloured by the arrival time over the expert's, failures marked. Returns `ax`."""
    style.dress(ax, "x [m]", "y [m]")
    draw_obstacles(ax, scene, "above", alpha=0.35)
    arrived = np.flatnonzero((test.outcome == ARRIVED) & np.isfinite(test.ratio))
    rows = arrived[np.argsort(test.ratio[arrived])]  # the late ones on top
    ratio, norm = test.ratio[rows], Normalize(*_spread(test.ratio[rows]))
    x, y = test.start[rows, 0], test.start[rows, 1]
    points = ax.scatter(x, y, c=ratio, cmap="viridis", norm=norm, s=6, linewidths=0, zorder=4)
    style.color_bar(points, ax, "arrival time over the duration of the expert's path", "both")
    for name, (color, marker) in FAILED_LOOKS.items():
        failed = test.start[test.outcome == OUTCOMES.index(name)]
        if len(failed):
            label = f"{name}: {len(failed)}"
            ax.scatter(failed[:, 0], failed[:, 1], s=40, c=color, marker=marker, zorder=5, label=label)
    draw_target(ax, scene, "above")
    ax.set_aspect("equal", adjustable="datalim")
    style.legend(ax, "upper right")
    return ax


def draw_arrival_times(ax: Axes, test: KinematicTest) -> Axes:
    """Cumulative distribution, over all starts, of the arrival time over the expert's. Returns `ax`."""
    style.dress(ax, "arrival time over the duration of the expert's path", "fraction of the starts")
    values = np.sort(test.ratio[(test.outcome == ARRIVED) & np.isfinite(test.ratio)])
    if len(values):
        ax.plot(values, np.arange(1, len(values) + 1) / len(test.outcome), color=style.BLUE, linewidth=1.6)
        low, high = min(1.0, values[0]), max(1.0, float(np.quantile(values, 0.999)))
        room = 0.05 * max(high - low, 0.01)
        ax.set_xlim(low - room, high + room)
    ax.axvline(1.0, color=style.BLACK, linewidth=0.8, linestyle=":")
    ax.set_ylim(0, 1.02)
    return ax


def worst_paths_figure(scene: Scene, test: KinematicTest) -> Figure:
    """Paths of the runs that failed, came nearest to an obstacle or arrived latest, from above and from the side."""
    figure, panels = _two_views(scene, test.worst_poses[..., :3].reshape(-1, 3))
    for ax, view in zip(panels, _VIEWS, strict=True):
        across, up = VIEW_AXES[view]
        for row, poses in zip(test.worst, test.worst_poses, strict=True):
            color = FAILED_LOOKS.get(OUTCOMES[int(test.outcome[row])], (style.BLUE, ""))[0]
            ax.plot(poses[:, across], poses[:, up], color=color, linewidth=0.9, alpha=0.8, zorder=4)
            ax.plot(poses[:1, across], poses[:1, up], "o", color=color, markersize=3, zorder=5)
    return figure


def error_map_figure(
    scene: Scene, poses: Float[np.ndarray, "m 4"], errors: Float[np.ndarray, " m"], unit: str = "m/s, yaw: rad/s"
) -> Figure:
    """The root mean square of the field's error on held-out labels, by place, from above and from the side.

    Args:
        scene: obstacles and target.
        poses: of the labels [m, rad].
        errors: mean square over the four outputs.
        unit: of the outputs.
    """
    figure, panels = _two_views(scene, poses[:, :3])
    low, high = _spread(np.sqrt(errors[errors > 0]))
    for ax, view in zip(panels, _VIEWS, strict=True):
        across, up = VIEW_AXES[view]
        cells = ax.hexbin(
            poses[:, across],
            poses[:, up],
            C=errors,
            reduce_C_function=lambda values: np.sqrt(np.mean(values)),
            gridsize=CELLS if view == "above" else (CELLS, CELLS // 4),
            norm=LogNorm(low, high),
            cmap="magma",
            linewidths=0.1,
        )
    style.color_bar(cells, panels, f"root mean square error [{unit}]", "both")
    return figure


def _two_views(scene: Scene, points: Float[np.ndarray, "n 3"]) -> tuple[Figure, list[Axes]]:
    """The scene from above, at equal scales, and below it from the side, both wide enough for all points [m]."""
    cloud = np.concatenate([points, scene.target[None, :3], scene.obstacle_centers])
    low, high = cloud.min(0) - ROOM, cloud.max(0) + ROOM
    width = 6.0  # [inch] of the panels
    above = width * (high[1] - low[1]) / (high[0] - low[0])
    figure = style.new_figure(width + 1.5, above + 0.35 * width + 1.2)
    panels = list(figure.subplots(2, 1, sharex=True, height_ratios=[above, 0.35 * width]))
    for ax, view in zip(panels, _VIEWS, strict=True):
        across, up = VIEW_AXES[view]
        style.dress(ax, AXIS_LABELS[across] if view == "side" else "", AXIS_LABELS[up])
        draw_obstacles(ax, scene, view, alpha=0.3)
        draw_target(ax, scene, view)
    panels[0].set_xlim(low[0], high[0])
    panels[0].set_ylim(low[1], high[1])
    panels[0].set_aspect("equal")
    return figure, panels


def _spread(values: Float[np.ndarray, " n"]) -> Range:
    """The range that holds nearly all of some positive numbers; around 1 where there are none."""
    low, high = np.quantile(values, _TAILS) if len(values) else (1.0, 1.0)
    return (float(low), float(high)) if low < high else (0.9 * float(low), 1.1 * float(high))
