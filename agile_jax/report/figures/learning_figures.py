"""Figures of the learned field: error by epoch, and streamlines seen from above and from the side."""

import json
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.ticker import MaxNLocator

from agile_jax.report.figures.scene_drawing import draw_obstacles, draw_target
from agile_jax.report.figures.style import BLUE, GREY, ORANGE, dress, legend, new_figure, save
from agile_jax.scene import POSE_SIZE, Scene, clearance
from agile_jax.settings import BadInput

SURROUNDINGS = 1.8  # [m] around target and obstacles, in which the field is drawn


def read_metrics(path: pathlib.Path) -> list[dict[str, Any]]:
    """The lines of a `metrics.jsonl`; a torn last line is left out.

    Raises:
        BadInput: another line is not a JSON object.
    """
    rows: list[dict[str, Any]] = []
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
        except ValueError as error:
            if number == len(lines):
                break
            raise BadInput(f"{path}, line {number}: not JSON ({error})") from error
        if not isinstance(row, dict):
            raise BadInput(f"{path}, line {number}: not a JSON object")
        rows.append(row)
    return rows


def draw_learning_curve(rows: list[dict[str, Any]], noise_floor: float | None, path: pathlib.Path) -> pathlib.Path:
    """Train and validation error by epoch on a logarithmic scale, with the labels' noise floor.

    Args:
        rows: one object per epoch with `epoch`, `train_mse` and `validation_mse` [mean of (m/s)^2 and (rad/s)^2].
        noise_floor: in the same unit, or None.
        path: of the PNG.
    """
    figure = new_figure(7.0, 3.6)
    axes = dress(figure.add_subplot(), "epoch", "mean squared error\n[(m/s)², (rad/s)²]")
    for key, label, color, dash in (("train_mse", "train", BLUE, "-"), ("validation_mse", "validation", ORANGE, "--")):
        points = [(row["epoch"], row[key]) for row in rows if _is_number(row.get("epoch")) and _is_number(row.get(key))]
        if points:
            epochs, errors = np.array(points, float).T
            marker = "o" if len(points) < 30 else None
            axes.plot(epochs, errors, dash, color=color, linewidth=1.6, marker=marker, markersize=3, label=label)
    if noise_floor is not None and noise_floor > 0:
        axes.axhline(noise_floor, color=GREY, linewidth=1.2, linestyle=":", label="noise floor of the labels")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if axes.get_legend_handles_labels()[0]:
        legend(axes)
    return save(figure, path)


def draw_velocity_field(
    scene: Scene, velocity: Callable[[np.ndarray], np.ndarray], heights: dict[str, float], path: pathlib.Path
) -> pathlib.Path:
    """Streamlines of the field in the plane at several heights, at the target's yaw; colour is the speed.

    Args:
        scene: obstacles, target and bounds; nothing is drawn where the torso would touch an obstacle.
        velocity: maps poses (n, 4) to velocities (n, 4) [m/s, rad/s].
        heights: by label [m].
        path: of the PNG.
    """
    places = np.vstack([scene.target[:2], scene.obstacle_centers[:, :2]])
    low = np.maximum(places.min(0) - SURROUNDINGS, scene.lower[:2])
    high = np.minimum(places.max(0) + SURROUNDINGS, scene.upper[:2])
    x, y = np.linspace(low[0], high[0], 61), np.linspace(low[1], high[1], 43)
    figure = new_figure(7.4, 3.9 * len(heights) + 0.4)
    panels = np.atleast_1d(figure.subplots(len(heights), 1, sharex=True))
    poses = np.zeros((len(y), len(x), POSE_SIZE))
    poses[..., 0], poses[..., 1] = np.meshgrid(x, y)
    poses[..., 3] = scene.target[3]
    lines = None
    fields, speeds = [], []
    for height in heights.values():
        poses[..., 2] = height
        field = np.asarray(velocity(poses.reshape(-1, POSE_SIZE))).reshape(poses.shape)
        blocked = clearance(scene, poses) < 0
        fields.append(np.where(blocked[..., None], np.nan, field))
        speeds.append(np.where(blocked, np.nan, np.hypot(field[..., 0], field[..., 1])))
    fastest = max(float(np.nanmax(np.stack(speeds))), 1e-6)
    for axes, label, field, speed in zip(panels, heights, fields, speeds, strict=True):
        dress(axes, y_label="y [m]", title=label)
        draw_obstacles(axes, scene, "above", alpha=0.35)
        norm = Normalize(0.0, fastest)
        look = {"cmap": "viridis", "norm": norm, "density": 1.3, "linewidth": 0.9, "arrowsize": 0.8}
        lines = axes.streamplot(x, y, field[..., 0], field[..., 1], color=speed, **look)
        draw_target(axes, scene, "above")
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
    panels[-1].set_xlabel("x [m]", fontsize=9)
    if lines is not None:
        bar = figure.colorbar(lines.lines, ax=list(panels), shrink=0.7)
        bar.set_label("speed in the plane [m/s]", fontsize=9)
        bar.ax.tick_params(labelsize=8)
    return save(figure, path)


def draw_velocity_field_side(
    scene: Scene, velocity: Callable[[np.ndarray], np.ndarray], path: pathlib.Path
) -> pathlib.Path:
    """Streamlines of the field in the vertical plane through the target along x, at the target's yaw.

    Args:
        scene: obstacles, target and bounds; nothing is drawn where the torso would touch an obstacle.
        velocity: maps poses (n, 4) to velocities (n, 4) [m/s, rad/s].
        path: of the PNG.
    """
    low, high = max(min(-0.8, scene.target[0] - 0.6), scene.lower[0]), min(scene.target[0] + 0.6, scene.upper[0])
    x, z = np.linspace(low, high, 121), np.linspace(scene.lower[2], scene.upper[2], 41)
    poses = np.tile(scene.target, (len(z), len(x), 1))
    poses[..., 0], poses[..., 2] = np.meshgrid(x, z)
    field = np.asarray(velocity(poses.reshape(-1, POSE_SIZE))).reshape(poses.shape)
    field = np.where((clearance(scene, poses) < 0)[..., None], np.nan, field)
    figure = new_figure(7.4, 2.9)
    axes = dress(figure.add_subplot(), "x [m]", "height of the torso's centre [m]")
    speed = np.hypot(field[..., 0], field[..., 2])
    lines = axes.streamplot(
        x,
        z,
        field[..., 0],
        field[..., 2],
        color=speed,
        cmap="viridis",
        density=(1.6, 0.8),
        linewidth=0.9,
        arrowsize=0.8,
    )
    draw_target(axes, scene, "side")
    axes.set_xlim(low, high)
    axes.set_ylim(z[0], z[-1])
    bar = figure.colorbar(lines.lines, ax=axes)
    bar.set_label("speed [m/s]", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    return save(figure, path)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and bool(np.isfinite(value))
