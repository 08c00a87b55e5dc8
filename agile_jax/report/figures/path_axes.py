"""A path of poses in its scene, from above, on axes of the caller's."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from agile_jax.report.figures.scene_drawing import draw_obstacles, draw_target, draw_torso
from agile_jax.report.figures.style import BLUE, dress, new_figure
from agile_jax.scene import Scene

GHOSTS = 9  # torso envelopes drawn along a path


def plot_path(
    scene: Scene, poses: Float[np.ndarray, "n 4"], axes: Axes | None = None, label: str = "", color: str = BLUE
) -> Axes:
    """Draw a path [m, rad] with the torso's envelope along it, obstacles and target.

    Args:
        scene: what stands around.
        poses: of the torso.
        axes: drawn on; those of a new figure when None.
        label: of the path in the legend.
        color: of the path.
    """
    axes = new_figure(7.0, 4.0).add_subplot() if axes is None else axes
    dress(axes, "x [m]", "y [m]")
    draw_obstacles(axes, scene, "above")
    for pose in poses[np.linspace(0, len(poses) - 1, GHOSTS).astype(int)]:
        draw_torso(axes, scene, pose, "above", color, alpha=0.07)
    axes.plot(poses[:, 0], poses[:, 1], color=color, linewidth=2.0, zorder=5, label=label or None)
    axes.plot(*poses[0, :2], "o", color="white", markeredgecolor=color, markersize=6, zorder=5.5)
    draw_target(axes, scene, "above")
    axes.set_aspect("equal", adjustable="datalim")
    if label:
        axes.legend(fontsize=8, frameon=False)
    return axes
