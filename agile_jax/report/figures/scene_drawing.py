"""The scene in three orthographic views: from above (x, y), from the side (x, z) and from the front (y, z)."""

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from agile_jax.geometry import rotation_2d
from agile_jax.report.figures.style import BLACK, GREY, OBSTACLE
from agile_jax.scene import Scene

View = Literal["above", "side", "front"]
VIEW_AXES: dict[View, tuple[int, int]] = {"above": (0, 1), "side": (0, 2), "front": (1, 2)}
AXIS_LABELS = ("x [m]", "y [m]", "z [m]")
_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def box_outline(center: np.ndarray, half: np.ndarray, yaw: float, view: View) -> np.ndarray:
    """Corners (4, 2) [m] of the silhouette of a box turned about the vertical.

    Args:
        center, half: shape (3,) [m].
        yaw: [rad].
        view: which two axes are seen.
    """
    footprint = center[:2] + (_CORNERS * half[:2]) @ rotation_2d(np.asarray(yaw)).T  # (4, 2)
    if view == "above":
        return footprint
    across = footprint[:, VIEW_AXES[view][0]]
    low, high = np.array([across.min(), across.max()]), np.array([center[2] - half[2], center[2] + half[2]])
    return np.array([[low[0], high[0]], [low[1], high[0]], [low[1], high[1]], [low[0], high[1]]])


def draw_obstacles(axes: Axes, scene: Scene, view: View, alpha: float = 0.55) -> None:
    """Fill the silhouette of every obstacle."""
    for center, half, yaw in zip(scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True):
        corners = box_outline(center, half, float(yaw), view)
        axes.add_patch(
            Polygon(corners, facecolor=OBSTACLE, edgecolor="#7A6A55", linewidth=0.8, alpha=alpha, zorder=1.5)
        )


def draw_floor(axes: Axes) -> None:
    """The floor of a side or front view."""
    axes.axhline(0.0, color=BLACK, linewidth=1.2, zorder=1)
    axes.axhspan(-1.0, 0.0, facecolor="#EFEFEF", zorder=0.5)


def draw_torso(axes: Axes, scene: Scene, pose: np.ndarray, view: View, color: str, alpha: float = 0.12) -> None:
    """The torso's envelope at `pose` (4,) [m, rad]."""
    corners = box_outline(pose[:3], scene.torso_half_size, float(pose[3]), view)
    axes.add_patch(Polygon(corners, facecolor=color, edgecolor="none", alpha=alpha, zorder=2))
    axes.add_patch(Polygon(corners, facecolor="none", edgecolor=color, linewidth=0.5, alpha=0.45, zorder=2.1))


def draw_target(axes: Axes, scene: Scene, view: View) -> None:
    """The target: an arrow along its yaw where that is seen, a diamond at its place elsewhere."""
    x, y, z, yaw = scene.target
    if view == "above":
        tip = (x + 0.3 * np.cos(yaw), y + 0.3 * np.sin(yaw))
        arrow = {"arrowstyle": "-|>", "color": BLACK, "linewidth": 1.6, "mutation_scale": 13}
        axes.annotate("", xy=tip, xytext=(x, y), arrowprops=arrow, zorder=6)
    across = y if view == "front" else x
    axes.plot([across], [y if view == "above" else z], "D", color=BLACK, markersize=4.5, zorder=6, label="target")


def frame(axes: Axes, low: np.ndarray, high: np.ndarray, view: View) -> None:
    """Limits of the view from those of space (3,), with equal scales and labels."""
    first, second = VIEW_AXES[view]
    axes.set_xlim(low[first], high[first])
    axes.set_ylim(low[second], high[second])
    axes.set_aspect("equal")
    axes.set_xlabel(AXIS_LABELS[first], fontsize=9)
    axes.set_ylabel(AXIS_LABELS[second], fontsize=9)
    if view != "above":
        axes.axhline(0.0, color=GREY, linewidth=0.5)
