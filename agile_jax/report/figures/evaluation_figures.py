"""Figures over all episodes of an evaluation: success by where they started, and distributions of their qualities."""

import pathlib
from typing import NamedTuple

import numpy as np
from matplotlib.patches import Rectangle

from agile_jax.report.figures.scene_drawing import draw_obstacles, draw_target
from agile_jax.report.figures.style import BLACK, BLUE, RED, dress, new_figure, save
from agile_jax.report.traces import OUTCOMES, Outcomes
from agile_jax.robot import GRAVITY
from agile_jax.scene import Scene

CELL = 0.25  # edge of a map's cells [m]
FEW = 400  # episodes below which the single starts say more than a map


class Quality(NamedTuple):
    """One number of each episode that has it."""

    label: str
    values: np.ndarray
    mark: float | None  # drawn as a line


def read_qualities(path: pathlib.Path, mass: float) -> list[Quality]:
    """Qualities of the episodes in `evaluation/<backend>.npz`; those that a file does not have are left out.

    Args:
        path: of the file.
        mass: of the robot [kg].
    """
    with np.load(path, allow_pickle=False) as file:
        columns = {name: np.asarray(file[name], float) for name in file.files if file[name].dtype.kind in "bif"}
    success = columns.get("outcome", np.zeros(0)) == OUTCOMES.index("success")
    found = []

    def add(label: str, needed: tuple[str, ...], scale: float, mark: float | None, only: np.ndarray | None) -> None:
        if not all(name in columns for name in needed):
            return
        with np.errstate(divide="ignore", invalid="ignore"):
            values = scale * columns[needed[0]]
            for name in needed[1:]:
                values = values / columns[name]
        values = values if only is None else values[only]
        values = np.sort(values[np.isfinite(values)])
        if len(values):
            found.append(Quality(label, values, mark))

    add("arrival time over the expert's", ("arrival_time", "expert_time"), 1.0, 1.0, success)
    add("least clearance of the robot [mm]", ("min_clearance",), 1e3, 0.0, None)
    add("velocity error, rms [m/s]", ("velocity_tracking_rmse",), 1.0, None, None)
    add("cost of transport", ("work", "distance"), 1 / (mass * GRAVITY), None, success)
    add("torques at their limit [%]", ("torque_saturation",), 100.0, None, None)
    return found


def draw_success_map(scene: Scene, outcomes: Outcomes, path: pathlib.Path) -> pathlib.Path | None:
    """Success by the start's cell in the plane: blue where all succeed, with the failures and the count in the others.

    None, and no file, for fewer than `FEW` episodes.
    """
    if len(outcomes.outcome) < FEW:
        return None
    figure = new_figure(8.0, 5.4)
    axes = dress(figure.add_subplot(), "x [m]", "y [m]")
    cells = np.floor(outcomes.start[:, :2] / CELL).astype(int)
    for cell in np.unique(cells, axis=0):
        inside = (cells == cell).all(1)
        count, failed = int(inside.sum()), int((outcomes.outcome[inside] != 0).sum())
        color = BLUE if failed == 0 else RED
        strength = 0.15 + 0.55 * (min(1.0, np.log10(count + 1) / 2.5) if failed == 0 else min(1.0, 4 * failed / count))
        axes.add_patch(
            Rectangle(tuple(cell * CELL), CELL, CELL, facecolor=color, alpha=strength, linewidth=0, zorder=3)
        )
        words = str(count) if failed == 0 else f"{failed}/{count}"
        x, y = (cell + 0.5) * CELL
        axes.text(x, y, words, ha="center", va="center", fontsize=5.5, color=BLACK, zorder=5)
    draw_obstacles(axes, scene, "above", alpha=0.35)
    draw_target(axes, scene, "above")
    low, high = cells.min(0) * CELL, (cells.max(0) + 1) * CELL
    axes.set_xlim(low[0], max(high[0], scene.target[0] + 0.3))
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="datalim")
    return save(figure, path)


def draw_qualities(qualities: list[Quality], path: pathlib.Path) -> pathlib.Path | None:
    """Cumulative distributions side by side; None, and no file, when there are none."""
    if not qualities:
        return None
    figure = new_figure(2.1 * len(qualities) + 0.6, 2.6)
    panels = np.atleast_1d(figure.subplots(1, len(qualities), sharey=True))
    for panel, (label, values, mark) in zip(panels, qualities, strict=True):
        dress(panel, label, "fraction of the episodes" if panel is panels[0] else "")
        panel.plot(values, np.arange(1, len(values) + 1) / len(values), color=BLUE, linewidth=1.5)
        if mark is not None:
            panel.axvline(mark, color=BLACK, linewidth=0.8, linestyle=":")
        panel.set_ylim(0, 1.02)
    return save(figure, path)
