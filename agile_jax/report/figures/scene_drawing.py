"""The scene in three orthographic views: from above (x, y), from the side (x, z) and from the front (y, z)."""

from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from agile_jax.geometry import rotation_2d
from agile_jax.report.figures.style import BLACK, GREY, OBSTACLE, OBSTACLE_EDGE
from agile_jax.scene import Scene

View = Literal["above", "side", "front"]
VIEW_AXES: dict[View, tuple[int, int]] = {"above": (0, 1), "side": (0, 2), "front": (1, 2)}
AXIS_LABELS = ("x [m]", "y [m]", "z [m]")
_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def box_outline(
    center: Float[np.ndarray, "3"], half: Float[np.ndarray, "3"], yaw: float, view: View
) -> Float[np.ndarray, "4 2"]:
    """Corners [m] of the silhouette of a box turned about the vertical.

    Args:
        center, half: its centre and half sizes [m].
        yaw: [rad].
        view: which two axes are seen.
    """
    footprint = center[:2] + (_CORNERS * half[:2]) @ rotation_2d(np.asarray(yaw)).T  # (4, 2)
    if view == "above":
        return footprint
    across = footprint[:, VIEW_AXES[view][0]]
    low, high = np.array([across.min(), across.max()]), np.array([center[2] - half[2], center[2] + half[2]])
    return np.array([[low[0], high[0]], [low[1], high[0]], [low[1], high[1]], [low[0], high[1]]])


def draw_obstacles(ax: Axes, scene: Scene, view: View, alpha: float = 0.55) -> None:
    """Fill the silhouette of every box of the obstacles."""
    for center, half, yaw in zip(scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True):
        corners = box_outline(center, half, float(yaw), view)
        ax.add_patch(
            Polygon(corners, facecolor=OBSTACLE, edgecolor=OBSTACLE_EDGE, linewidth=0.8, alpha=alpha, zorder=1.5)
        )


def draw_floor(ax: Axes) -> None:
    """The floor of a side or front view."""
    ax.axhline(0.0, color=BLACK, linewidth=1.2, zorder=1)
    ax.axhspan(-1.0, 0.0, facecolor="#EFEFEF", zorder=0.5)


def draw_torso(ax: Axes, scene: Scene, pose: Float[np.ndarray, "4"], view: View, color: str, alpha: float) -> None:
    """The torso's envelope at a pose [m, rad]."""
    corners = box_outline(pose[:3], scene.torso_half_size, float(pose[3]), view)
    ax.add_patch(Polygon(corners, facecolor=color, edgecolor="none", alpha=alpha, zorder=2))
    ax.add_patch(Polygon(corners, facecolor="none", edgecolor=color, linewidth=0.5, alpha=0.45, zorder=2.1))


def draw_target(ax: Axes, scene: Scene, view: View) -> None:
    """The target: a diamond at its place; from above also an arrow along its yaw."""
    x, y, z, yaw = scene.target
    if view == "above":
        tip = (x + 0.3 * np.cos(yaw), y + 0.3 * np.sin(yaw))
        arrow = {"arrowstyle": "-|>", "color": BLACK, "linewidth": 1.6, "mutation_scale": 13}
        ax.annotate("", xy=tip, xytext=(x, y), arrowprops=arrow, zorder=6)
    across = y if view == "front" else x
    ax.plot([across], [y if view == "above" else z], "D", color=BLACK, markersize=4.5, zorder=6, label="target")


def frame(ax: Axes, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], view: View) -> None:
    """Limits of the view from those of space [m], with equal scales and labels."""
    first, second = VIEW_AXES[view]
    ax.set_xlim(low[first], high[first])
    ax.set_ylim(low[second], high[second])
    ax.set_aspect("equal")
    ax.set_xlabel(AXIS_LABELS[first], fontsize=9)
    ax.set_ylabel(AXIS_LABELS[second], fontsize=9)
    if view != "above":
        ax.axhline(0.0, color=GREY, linewidth=0.5)
