"""Figures over all episodes of an evaluation: how they ended by where they started, and their qualities."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from agile_jax.report.figures import style
from agile_jax.report.figures.scene_drawing import draw_obstacles, draw_target
from agile_jax.report.reading import Outcomes
from agile_jax.robot import GRAVITY
from agile_jax.scene import Scene
from agile_jax.simulation import OUTCOME_NAMES, SUCCESS

CELL = 0.25  # edge of a map's cells [m]
OUTCOME_LOOKS = {  # colour and marker: told apart without colour, too
    "success": (style.BLUE, "o"),
    "collision": (style.RED, "X"),
    "fall": (style.ORANGE, "v"),
    "timeout": (style.PURPLE, "s"),
    "unstable": (style.BLACK, "P"),
}


class Quality(NamedTuple):
    """One number of each episode that has it."""

    label: str
    values: Float[np.ndarray, " n"]
    mark: float | None = None  # drawn as a line


def qualities(columns: Mapping[str, Float[np.ndarray, " n"]], mass: float) -> list[Quality]:
    """Qualities of n episodes from the columns of their evaluation; those without a column are left out.

    Args:
        columns: by name; `load_columns` reads them.
        mass: of the robot [kg].
    """
    success = columns.get("outcome", np.zeros(0)) == SUCCESS
    every = np.ones_like(success)
    found = []
    for label, names, scale, mark, counted in (
        ("arrival time over the expert's", ("arrival_time", "expert_arrival_time"), 1.0, 1.0, success),
        ("least clearance of the robot [mm]", ("min_clearance",), 1e3, 0.0, every),
        ("velocity error, rms [m/s]", ("velocity_tracking_rmse",), 1.0, None, every),
        ("cost of transport", ("work", "distance"), 1 / (mass * GRAVITY), None, success),
        ("torques at their limit [%]", ("torque_saturation",), 100.0, None, every),
    ):
        if not all(name in columns for name in names):
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            values = scale * columns[names[0]] / (columns[names[1]] if len(names) > 1 else 1.0)
        values = values[counted & np.isfinite(values)]
        if len(values):
            found.append(Quality(label, values, mark))
    return found


def draw_outcomes(ax: Axes, scene: Scene, outcomes: Outcomes) -> Axes:
    """Starts in the plane, coloured by how their episode ended, with obstacles, target and counts. Returns `ax`."""
    style.dress(ax, "x [m]", "y [m]")
    draw_obstacles(ax, scene, "above")
    for number, name in enumerate(OUTCOME_NAMES):
        starts = outcomes.start[outcomes.outcome == number]
        color, marker = OUTCOME_LOOKS[name]
        size, alpha, order = (28, 0.65, 4.0) if number == SUCCESS else (46, 0.95, 4.1)
        ax.scatter(
            starts[:, 0],
            starts[:, 1],
            s=size,
            c=color,
            marker=marker,
            alpha=alpha,
            linewidths=0.5,
            edgecolors="white",
            zorder=order,
            label=f"{name}: {len(starts)}",
        )
    draw_target(ax, scene, "above")
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.08)
    style.legend(ax, outside=True, title=f"{len(outcomes.outcome)} starts")
    return ax


def draw_success_map(ax: Axes, scene: Scene, outcomes: Outcomes) -> Axes:
    """Success by the start's cell in the plane: blue where all succeed, with the failures and the count in the others.

    Returns `ax`. Few hundred episodes are better seen one by one: `draw_outcomes`.
    """
    style.dress(ax, "x [m]", "y [m]")
    cells = np.floor(outcomes.start[:, :2] / CELL).astype(int)
    for cell in np.unique(cells, axis=0):
        inside = (cells == cell).all(1)
        count, failed = int(inside.sum()), int((outcomes.outcome[inside] != SUCCESS).sum())
        color = style.BLUE if failed == 0 else style.RED
        strength = 0.15 + 0.55 * (min(1.0, np.log10(count + 1) / 2.5) if failed == 0 else min(1.0, 4 * failed / count))
        square = Rectangle(tuple(cell * CELL), CELL, CELL, facecolor=color, alpha=strength, linewidth=0, zorder=3)
        ax.add_patch(square)
        words = str(count) if failed == 0 else f"{failed}/{count}"
        x, y = (cell + 0.5) * CELL
        ax.text(x, y, words, ha="center", va="center", fontsize=5.5, color=style.BLACK, zorder=5)
    draw_obstacles(ax, scene, "above", alpha=0.35)
    draw_target(ax, scene, "above")
    low, high = cells.min(0) * CELL, (cells.max(0) + 1) * CELL
    ax.set_xlim(low[0], max(high[0], scene.target[0] + 0.3))
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal", adjustable="datalim")
    return ax


def qualities_figure(found: list[Quality]) -> Figure:
    """Cumulative distributions of at least one quality, side by side."""
    figure = style.new_figure(2.1 * len(found) + 0.6, 2.6)
    panels = np.atleast_1d(figure.subplots(1, len(found), sharey=True))
    for ax, quality in zip(panels, found, strict=True):
        style.dress(ax, quality.label)
        values = np.sort(quality.values)
        ax.plot(values, np.arange(1, len(values) + 1) / len(values), color=style.BLUE, linewidth=1.5)
        if quality.mark is not None:
            ax.axvline(quality.mark, color=style.BLACK, linewidth=0.8, linestyle=":")
        ax.set_ylim(0, 1.02)
    panels[0].set_ylabel("fraction of the episodes", fontsize=9)
    return figure
