"""Figures of the learner's own test: where the field errs, from where it arrives how late, and its worst paths."""

import pathlib
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, Normalize

from agile_jax.report.figures.scene_drawing import VIEW_AXES, View, draw_obstacles, draw_target
from agile_jax.report.figures.style import BLACK, BLUE, ORANGE, PURPLE, RED, dress, legend, new_figure, save
from agile_jax.scene import Scene

OUTCOMES = ("arrived", "collided", "stalled", "timeout")
FAILED_LOOKS = {"collided": (RED, "X"), "stalled": (ORANGE, "v"), "timeout": (PURPLE, "s")}
_VIEWS: tuple[View, View] = ("above", "side")
CELLS = 60  # hexagons across an error map


class ClosedLoop(NamedTuple):
    """n loops of the held-out test (training/kinematic_test/held_out.py)."""

    start: np.ndarray  # (n, 4) [m, rad]
    outcome: np.ndarray  # (n,) index into OUTCOMES
    ratio: np.ndarray  # (n,) arrival time over the expert's
    min_clearance: np.ndarray  # (n,) [m]
    worst: np.ndarray  # (k,) rows
    worst_poses: np.ndarray  # (k, K + 1, 4) [m, rad]


def read_closed_loop(path: pathlib.Path) -> ClosedLoop:
    """The rows of a `closed_loop.npz`."""
    with np.load(path, allow_pickle=False) as file:
        ratio = file["arrival_time"] / file["expert_time"]
        same = {name: file[name] for name in ("start", "outcome", "min_clearance", "worst", "worst_poses")}
    return ClosedLoop(ratio=ratio, **same)


def draw_arrivals(scene: Scene, loops: ClosedLoop, path: pathlib.Path) -> pathlib.Path:
    """Starts in the plane, coloured by the arrival time over the expert's, failures marked; and its distribution."""
    figure = new_figure(9.0, 4.2)
    left, right = figure.subplots(1, 2, width_ratios=[1.6, 1.0])
    dress(left, "x [m]", "y [m]")
    draw_obstacles(left, scene, "above", alpha=0.35)
    shown = (loops.outcome == 0) & np.isfinite(loops.ratio)
    order = np.flatnonzero(shown)[np.argsort(loops.ratio[shown])]  # the late ones on top
    look = {"cmap": "viridis", "norm": Normalize(0.95, 1.1), "s": 6, "linewidths": 0, "zorder": 4}
    points = left.scatter(loops.start[order, 0], loops.start[order, 1], c=loops.ratio[order], **look)
    bar = figure.colorbar(points, ax=left, shrink=0.8, extend="both")
    bar.set_label("arrival time over the expert's", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    for name, (color, marker) in FAILED_LOOKS.items():
        failed = loops.start[loops.outcome == OUTCOMES.index(name)]
        if len(failed):
            label = f"{name}: {len(failed)}"
            left.scatter(failed[:, 0], failed[:, 1], s=40, c=color, marker=marker, zorder=5, label=label)
    draw_target(left, scene, "above")
    left.set_aspect("equal", adjustable="datalim")
    legend(left, loc="upper right")
    dress(right, "arrival time over the expert's", "fraction of the starts")
    values = np.sort(loops.ratio[shown])
    if len(values):
        right.plot(values, np.arange(1, len(values) + 1) / len(loops.outcome), color=BLUE, linewidth=1.6)
        right.set_xlim(min(values[0], 0.95), max(np.quantile(values, 0.999), 1.05))
    right.axvline(1.0, color=BLACK, linewidth=0.8, linestyle=":")
    right.set_ylim(0, 1.02)
    return save(figure, path)


def draw_worst_paths(scene: Scene, loops: ClosedLoop, path: pathlib.Path) -> pathlib.Path:
    """Paths of the loops that failed, came nearest to an obstacle, or arrived latest, from above and from the side."""
    figure = new_figure(7.4, 6.4)
    panels = figure.subplots(2, 1, sharex=True, height_ratios=[1.7, 1.0])
    for axes, view in zip(panels, _VIEWS, strict=True):
        across, up = VIEW_AXES[view]
        dress(axes, "x [m]" if view == "side" else "", ("y [m]", "z [m]")[view == "side"])
        draw_obstacles(axes, scene, view, alpha=0.35)
        for row, poses in zip(loops.worst, loops.worst_poses, strict=True):
            name = OUTCOMES[int(loops.outcome[row])]
            color = FAILED_LOOKS[name][0] if name in FAILED_LOOKS else BLUE
            axes.plot(poses[:, across], poses[:, up], color=color, linewidth=0.9, alpha=0.8, zorder=4)
            axes.plot(poses[:1, across], poses[:1, up], "o", color=color, markersize=3, zorder=5)
        draw_target(axes, scene, view)
    panels[0].set_aspect("equal", adjustable="datalim")
    return save(figure, path)


def draw_error_map(scene: Scene, poses: np.ndarray, errors: np.ndarray, path: pathlib.Path) -> pathlib.Path:
    """The root mean square of the field's error on held-out labels, by place, from above and from the side.

    Args:
        scene: obstacles and target.
        poses: shape (m, 4) [m, rad].
        errors: mean square over the outputs, shape (m,) [(m/s)^2, (rad/s)^2].
        path: of the PNG.
    """
    figure = new_figure(7.4, 6.4)
    panels = figure.subplots(2, 1, sharex=True, height_ratios=[1.7, 1.0])
    cells = None
    for axes, view in zip(panels, _VIEWS, strict=True):
        cells = _error_cells(axes, scene, poses, errors, view)
    panels[0].set_aspect("equal", adjustable="datalim")
    if cells is not None:
        bar = figure.colorbar(cells, ax=list(panels), shrink=0.7)
        bar.set_label("root mean square error [m/s, rad/s]", fontsize=9)
        bar.ax.tick_params(labelsize=8)
    return save(figure, path)


def _error_cells(axes: Axes, scene: Scene, poses: np.ndarray, errors: np.ndarray, view: View) -> PolyCollection:
    across, up = VIEW_AXES[view]
    dress(axes, "x [m]" if view == "side" else "", ("y [m]", "z [m]")[view == "side"])
    draw_obstacles(axes, scene, view, alpha=0.2)
    draw_target(axes, scene, view)
    return axes.hexbin(
        poses[:, across],
        poses[:, up],
        C=errors,
        reduce_C_function=lambda values: np.sqrt(np.mean(values)),
        gridsize=CELLS if view == "above" else (CELLS, CELLS // 4),
        norm=LogNorm(1e-3, 0.3),
        cmap="magma",
        linewidths=0.1,
    )
