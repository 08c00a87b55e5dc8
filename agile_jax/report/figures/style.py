"""The look of the figures: colours that colour-blind readers can tell apart, and no global state of pyplot.

The colours are those of Okabe and Ito (Color Universal Design, 2008), with the red of P. Tol's vibrant scheme.
"""

import io
import pathlib
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from agile_jax.files import write_atomic

BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#CC3311"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#222222", "#8A8A8A"
OBSTACLE = "#B9A48B"
DOTS_PER_INCH = 150


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of `width` x `height` [inch] on its own Agg canvas."""
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def dress(axes: Axes, x_label: str = "", y_label: str = "", title: str = "") -> Axes:
    """Labels, a light grid and no box around the data."""
    axes.set_xlabel(x_label, fontsize=9)
    axes.set_ylabel(y_label, fontsize=9)
    if title:
        axes.set_title(title, fontsize=10, loc="left")
    axes.tick_params(which="both", labelsize=8, color=GREY)
    axes.grid(True, color="#E6E6E6", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)
    return axes


def legend(axes: Axes, **options: Any) -> None:
    """A legend in the style of the figures."""
    axes.legend(**{"fontsize": 8, "frameon": True, "framealpha": 0.85, "edgecolor": "none", **options})


def save(figure: Figure, path: pathlib.Path) -> pathlib.Path:
    """Write the figure as PNG, atomically, the same bytes for the same figure. Returns `path`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    write_atomic(path, buffer.getvalue())
    return path
