"""Figures of the closed loop: outcomes over the starts, and one episode over time."""

import pathlib
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from agile_jax.report.figures.scene_drawing import draw_obstacles, draw_target
from agile_jax.report.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    OBSTACLE,
    ORANGE,
    PURPLE,
    RED,
    dress,
    legend,
    new_figure,
    save,
)
from agile_jax.report.traces import OUTCOMES, Episode, Outcomes, below_obstacle
from agile_jax.scene import POSE_SIZE, Scene

OUTCOME_LOOKS = {  # colour and marker: told apart without colour, too
    "success": (BLUE, "o"),
    "collision": (RED, "X"),
    "fall": (ORANGE, "v"),
    "timeout": (PURPLE, "s"),
    "unstable": (BLACK, "P"),
}
JOINTS = ("abad", "hip", "knee")
_JOINT_COLORS = (BLUE, ORANGE, PURPLE)


def draw_outcomes(scene: Scene, outcomes: Outcomes, path: pathlib.Path) -> pathlib.Path:
    """Starts in the plane, coloured by how their episode ended, with obstacles, target and counts."""
    figure = new_figure(8.0, 4.6)
    axes = dress(figure.add_subplot(), "x [m]", "y [m]")
    draw_obstacles(axes, scene, "above")
    for number, name in enumerate(OUTCOMES):
        starts = outcomes.start[outcomes.outcome == number]
        color, marker = OUTCOME_LOOKS[name]
        axes.scatter(
            starts[:, 0],
            starts[:, 1],
            s=28 if name == "success" else 46,
            c=color,
            marker=marker,
            alpha=0.65 if name == "success" else 0.95,
            linewidths=0.5,
            edgecolors="white",
            zorder=4 + 0.1 * (name != "success"),
            label=f"{name}: {len(starts)}",
        )
    draw_target(axes, scene, "above")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    legend(
        axes, title=f"{len(outcomes.outcome)} starts", title_fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5)
    )
    return save(figure, path)


def draw_episode(scene: Scene, episode: Episode, torque_limit: np.ndarray, path: pathlib.Path) -> pathlib.Path:
    """Height, speed, clearance and torques of one episode over time.

    Args:
        scene: for the underside of what the robot passes and the torso's envelope.
        episode: K moments.
        torque_limit: shape (12,) [N m].
        path: of the PNG.
    """
    figure = new_figure(8.0, 8.6)
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[1.2, 1.0, 0.8, 1.3])
    time = episode.time - episode.time[0]
    _draw_height(dress(panels[0], y_label="height [m]"), scene, episode, time)

    speed = dress(panels[1], y_label="speed [m/s]")
    wanted = np.hypot(episode.reference[:, POSE_SIZE], episode.reference[:, POSE_SIZE + 1])
    speed.plot(
        time, np.hypot(episode.qvel[:, 0], episode.qvel[:, 1]), color=BLUE, linewidth=1.3, label="trunk, in the plane"
    )
    speed.plot(time, wanted, color=BLACK, linewidth=1.2, linestyle="--", label="reference")
    speed.set_ylim(bottom=0.0)
    legend(speed, loc="lower center", ncols=2)

    clearance = dress(panels[2], y_label="clearance [m]")
    clearance.axhspan(-1.0, 0.0, facecolor=RED, alpha=0.12)
    clearance.axhline(0.0, color=RED, linewidth=0.8)
    clearance.plot(time, episode.clearance, color=GREEN, linewidth=1.4)
    finite = episode.clearance[np.isfinite(episode.clearance)]
    least = float(finite.min()) if len(finite) else 0.0
    clearance.set_ylim(min(-0.03, 1.2 * least), max(0.15, min(0.6, 1.1 * float(finite.max()) if len(finite) else 0.6)))
    if len(finite):
        moment = float(time[int(np.nanargmin(np.where(np.isfinite(episode.clearance), episode.clearance, np.nan)))])
        clearance.plot([moment], [least], "o", color=GREEN, markersize=4)
        late = moment > 0.7 * time[-1]
        words: dict[str, Any] = {"textcoords": "offset points", "ha": "right" if late else "left", "fontsize": 8}
        clearance.annotate(f"least: {1e3 * least:.0f} mm", (moment, least), (-6 if late else 6, 8), **words)

    _draw_torques(dress(panels[3], "time [s]", "torque [N m]"), episode, torque_limit, time)
    panels[3].set_xlim(0.0, max(float(time[-1]), 1e-3))
    figure.align_ylabels(panels)
    return save(figure, path)


def _draw_height(axes: Axes, scene: Scene, episode: Episode, time: np.ndarray) -> None:
    height, half = episode.qpos[:, 2], scene.torso_half_size[2]
    ceiling = below_obstacle(scene, episode.qpos[:, :3])
    axes.fill_between(time, height - half, height + half, color=BLUE, alpha=0.15, linewidth=0, label="torso envelope")
    axes.plot(time, height, color=BLUE, linewidth=1.5, label="trunk's centre")
    axes.plot(time, episode.reference[:, 2], color=BLACK, linewidth=1.2, linestyle="--", label="reference")
    top = float(max(np.nanmax(height + half), 0.36)) + 0.04
    if np.isfinite(ceiling).any():
        axes.fill_between(time, ceiling, top, color=OBSTACLE, alpha=0.55, linewidth=0, label="obstacle above the trunk")
        axes.plot(time, ceiling, color="#7A6A55", linewidth=1.2)
    axes.set_ylim(0.0, top)
    legend(axes, loc="lower right", ncols=2)


def _draw_torques(axes: Axes, episode: Episode, limit: np.ndarray, time: np.ndarray) -> None:
    for joint, (name, color) in enumerate(zip(JOINTS, _JOINT_COLORS, strict=True)):
        for leg in range(4):
            label = name if leg == 0 else None
            axes.plot(time, episode.torque[:, 3 * leg + joint], color=color, linewidth=0.6, alpha=0.75, label=label)
    for number, value in enumerate(np.unique(np.abs(limit))):
        for sign in (-1.0, 1.0):
            label = "limit" if number == 0 and sign > 0 else None
            axes.axhline(sign * value, color=GREY, linewidth=0.9, linestyle=":", label=label)
    axes.set_ylim(-1.15 * np.abs(limit).max(), 1.5 * np.abs(limit).max())
    legend(axes, loc="upper right", ncols=4)
