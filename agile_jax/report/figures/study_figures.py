"""Figures of a study: success, clearance and arrival time against the number that it varies."""

from collections.abc import Mapping
from itertools import cycle
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agile_jax.report.figures import style

Columns: TypeAlias = Mapping[str, Float[np.ndarray, " n"]]  # n values of a curve, "value" increasing; NaN: not known
Curves: TypeAlias = Mapping[str, Columns]  # by label

COLORS = (style.BLUE, style.ORANGE, style.GREEN, style.RED, style.PURPLE, style.BLACK)
MARKERS = ("o", "s", "^", "D", "v", "P")
UNDER, RATIO = "starts_under", "arrival_time_ratio_same_tolerance"


def study_figure(curves: Curves, axis: str, title: str = "") -> Figure:
    """Success, clearance and arrival time, one below the other; what no value has is left out.

    Args:
        curves: of at least one value.
        axis: what the varied number is called, with its unit.
        title: of the figure.
    """
    drawn = [draw_success]
    drawn += [draw_clearance] if _known(curves, "min_clearance_m_p05") else []
    drawn += [draw_arrival] if _known(curves, f"{RATIO}_median") else []
    figure = style.new_figure(7.4, 1.2 + 2.3 * len(drawn))
    panels = np.atleast_1d(figure.subplots(len(drawn), 1, sharex=True))
    for draw, ax in zip(drawn, panels, strict=True):
        draw(ax, curves)
    panels[-1].set_xlabel(axis, fontsize=9)
    figure.align_ylabels(panels)
    if title:
        figure.suptitle(title, fontsize=11)
    return figure


def draw_success(ax: Axes, curves: Curves) -> Axes:
    """Success rate with its 95 % Wilson band; dotted, the share of the starts whose path goes under. Returns `ax`."""
    style.dress(ax, y_label="success rate")
    for (label, columns), color, marker in zip(curves.items(), cycle(COLORS), cycle(MARKERS), strict=False):
        value, rate = columns["value"], columns["success_rate"]
        ax.fill_between(
            value, columns["success_rate_low"], columns["success_rate_high"], color=color, alpha=0.18, linewidth=0
        )
        ax.plot(value, rate, color=color, marker=marker, markersize=3.5, linewidth=1.5, label=label or "success, 95 %")
        if UNDER in columns and columns[UNDER].any():
            words = f"{label}: path goes under".removeprefix(": ")
            share = columns[UNDER] / columns["episodes"]
            ax.plot(value, share, color=color if label else style.GREY, linestyle=":", linewidth=1.2, label=words)
    ax.set_ylim(-0.03, 1.03)
    style.legend(ax)
    return ax


def draw_clearance(ax: Axes, curves: Curves) -> Axes:
    """Least clearance of the whole robot in an episode: 5th percentile and, dashed, median [mm]. Returns `ax`."""
    style.dress(ax, y_label="least clearance of\nthe robot [mm]")
    _draw_pair(ax, curves, "min_clearance_m_p05", "min_clearance_m_median", ("5th percentile", "median"), 1e3)
    low, high = min(ax.get_ylim()[0], -5.0), ax.get_ylim()[1]
    ax.axhspan(low, 0.0, facecolor=style.RED, alpha=0.12)
    ax.axhline(0.0, color=style.RED, linewidth=0.8)
    ax.set_ylim(low, high + 0.05 * (high - low))
    return ax


def draw_arrival(ax: Axes, curves: Curves) -> Axes:
    """Arrival time over that of the expert's path: median and, dashed, 95th percentile. Returns `ax`."""
    style.dress(ax, y_label="arrival time over\nthe expert's")
    _draw_pair(ax, curves, f"{RATIO}_median", f"{RATIO}_p95", ("median", "95th percentile"), 1.0)
    ax.axhline(1.0, color=style.BLACK, linewidth=0.8, linestyle=":")
    return ax


def _draw_pair(ax: Axes, curves: Curves, solid: str, dashed: str, words: tuple[str, str], scale: float) -> None:
    """Two columns of every curve; only those of the first curve are explained."""
    for columns, color, marker in zip(curves.values(), cycle(COLORS), cycle(MARKERS), strict=False):
        for name, dash, word in ((solid, "-", words[0]), (dashed, "--", words[1])):
            label = word if columns is next(iter(curves.values())) else None
            y = scale * columns[name]
            ax.plot(columns["value"], y, dash, color=color, marker=marker, markersize=3, linewidth=1.3, label=label)
    style.legend(ax, columns=2)


def _known(curves: Curves, name: str) -> bool:
    return any(np.isfinite(columns[name]).any() for columns in curves.values())
