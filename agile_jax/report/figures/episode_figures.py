"""Figures of one recorded episode over time: height, speed, clearance and torques."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agile_jax.report.figures import style
from agile_jax.report.under_obstacles import underside_above
from agile_jax.scene import POSE_SIZE, Scene
from agile_jax.simulation import Trace

JOINTS = ("abad", "hip", "knee")
_JOINT_COLORS = (style.BLUE, style.ORANGE, style.PURPLE)


def episode_figure(scene: Scene, trace: Trace, torque_limit: Float[np.ndarray, "12"]) -> Figure:
    """Height, speed, clearance and torques of one episode over time, one below the other.

    Args:
        scene: for the underside of what the robot passes and the torso's envelope.
        trace: of the episode.
        torque_limit: of the joints [N m].
    """
    figure = style.new_figure(8.0, 8.6)
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[1.2, 1.0, 0.8, 1.3])
    draw_height(panels[0], scene, trace)
    draw_speed(panels[1], trace)
    draw_clearance(panels[2], trace)
    draw_torques(panels[3], trace, torque_limit)
    panels[3].set_xlabel("time [s]", fontsize=9)
    panels[3].set_xlim(0.0, max(float(_time(trace)[-1]), 1e-3))
    figure.align_ylabels(panels)
    return figure


def draw_height(ax: Axes, scene: Scene, trace: Trace) -> Axes:
    """Height of the trunk, of its reference and of what is above it, over time. Returns `ax`."""
    style.dress(ax, y_label="height [m]")
    time, height, half = _time(trace), trace.qpos[:, 2], scene.torso_half_size[2]
    ceiling = underside_above(scene, np.asarray(trace.qpos[:, :3]))
    ax.fill_between(
        time, height - half, height + half, color=style.BLUE, alpha=0.15, linewidth=0, label="torso envelope"
    )
    ax.plot(time, height, color=style.BLUE, linewidth=1.5, label="trunk's centre")
    ax.plot(time, trace.reference[:, 2], color=style.BLACK, linewidth=1.2, linestyle="--", label="reference")
    top = 1.1 * float(np.nanmax([*(height + half), *ceiling]))
    if np.isfinite(ceiling).any():
        ax.fill_between(
            time, ceiling, top, color=style.OBSTACLE, alpha=0.55, linewidth=0, label="obstacle above the trunk"
        )
        ax.plot(time, ceiling, color=style.OBSTACLE_EDGE, linewidth=1.2)
    ax.set_ylim(0.0, top)
    style.legend(ax, "lower right", columns=2)
    return ax


def draw_speed(ax: Axes, trace: Trace) -> Axes:
    """Speed of the trunk in the plane and that of its reference over time. Returns `ax`."""
    style.dress(ax, y_label="speed [m/s]")
    time = _time(trace)
    wanted = np.hypot(trace.reference[:, POSE_SIZE], trace.reference[:, POSE_SIZE + 1])
    ax.plot(time, np.hypot(*trace.qvel[:, :2].T), color=style.BLUE, linewidth=1.3, label="trunk, in the plane")
    ax.plot(time, wanted, color=style.BLACK, linewidth=1.2, linestyle="--", label="reference")
    ax.set_ylim(bottom=0.0)
    style.legend(ax, "lower center", columns=2)
    return ax


def draw_clearance(ax: Axes, trace: Trace) -> Axes:
    """Distance of the torso's envelope to the nearest obstacle over time, its least value marked. Returns `ax`."""
    style.dress(ax, y_label="clearance [m]")
    time = _time(trace)
    ax.axhspan(-1.0, 0.0, facecolor=style.RED, alpha=0.12)
    ax.axhline(0.0, color=style.RED, linewidth=0.8)
    ax.plot(time, trace.clearance, color=style.GREEN, linewidth=1.4)
    finite = np.isfinite(trace.clearance)
    if not finite.any():
        ax.set_ylim(-0.03, 0.6)
        return ax
    row = int(np.argmin(np.where(finite, trace.clearance, np.inf)))
    moment, least = float(time[row]), float(trace.clearance[row])
    ax.set_ylim(min(-0.03, 1.2 * least), max(0.15, min(0.6, 1.1 * float(trace.clearance[finite].max()))))
    ax.plot([moment], [least], "o", color=style.GREEN, markersize=4)
    late = moment > 0.7 * time[-1]
    ax.annotate(
        f"least: {1e3 * least:.0f} mm",
        (moment, least),
        (-6 if late else 6, 8),
        textcoords="offset points",
        ha="right" if late else "left",
        fontsize=8,
    )
    return ax


def draw_torques(ax: Axes, trace: Trace, torque_limit: Float[np.ndarray, "12"]) -> Axes:
    """Torques of the twelve joints over time, and their limits [N m]. Returns `ax`."""
    style.dress(ax, y_label="torque [N m]")
    time, limits = _time(trace), np.unique(np.abs(torque_limit))
    for joint, (name, color) in enumerate(zip(JOINTS, _JOINT_COLORS, strict=True)):
        lines = ax.plot(time, trace.torque[:, joint::3], color=color, linewidth=0.6, alpha=0.75)
        lines[0].set_label(name)
    for number, value in enumerate([*limits, *-limits]):
        label = "limit" if number == 0 else None
        ax.axhline(value, color=style.GREY, linewidth=0.9, linestyle=":", label=label)
    ax.set_ylim(-1.15 * limits[-1], 1.5 * limits[-1])
    style.legend(ax, "upper right", columns=4)
    return ax


def _time(trace: Trace) -> Float[np.ndarray, " K"]:
    """Time since the first sample [s]."""
    return np.asarray(trace.time - trace.time[0])
