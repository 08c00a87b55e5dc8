"""The look of the figures: colours that colour-blind readers can tell apart, and no global state of pyplot.

The colours are those of Okabe and Ito (Color Universal Design, 2008), with the red of P. Tol's vibrant scheme.
"""

import io
import pathlib
from typing import Literal, TypeAlias

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from agile_jax.files import write_atomic

BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#CC3311"
PURPLE, BLACK, GREY = "#CC79A7", "#222222", "#8A8A8A"
OBSTACLE, OBSTACLE_EDGE = "#B9A48B", "#7A6A55"
DOTS_PER_INCH = 150
Ends: TypeAlias = Literal["neither", "both", "min", "max"]


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of `width` x `height` [inch] on its own Agg canvas."""
    figure = Figure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def new_axes(width: float = 7.0, height: float = 4.0) -> Axes:
    """The only axes of a new figure of `width` x `height` [inch]: `new_axes().figure`."""
    return new_figure(width, height).add_subplot()


def dress(ax: Axes, x_label: str = "", y_label: str = "") -> None:
    """Labels, a light grid and no box around the data."""
    ax.set_xlabel(x_label, fontsize=9)
    ax.set_ylabel(y_label, fontsize=9)
    ax.tick_params(which="both", labelsize=8, color=GREY)
    ax.grid(True, color="#E6E6E6", linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(GREY)


def legend(ax: Axes, location: str = "best", columns: int = 1, outside: bool = False, title: str | None = None) -> None:
    """A legend in the style of the figures; `outside` puts it to the right of the axes."""
    box = (1.01, 0.5) if outside else None
    ax.legend(
        loc="center left" if outside else location,
        bbox_to_anchor=box,
        ncols=columns,
        title=title,
        fontsize=8,
        title_fontsize=8,
        framealpha=0.85,
        edgecolor="none",
    )


def color_bar(drawn: ScalarMappable, axes: Axes | list[Axes], label: str, extend: Ends = "neither") -> None:
    """A colour bar beside `axes` that explains the colours of `drawn`; `extend` says which ends are cut off."""
    first = axes[0] if isinstance(axes, list) else axes
    bar = first.figure.colorbar(drawn, ax=axes, shrink=0.8, extend=extend)
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)


def save_figure(drawn: Figure | Axes, path: pathlib.Path) -> pathlib.Path:
    """Write a figure, or that of axes, as PNG, atomically, the same bytes for the same figure. Returns `path`."""
    figure, buffer = drawn.figure, io.BytesIO()
    assert isinstance(figure, Figure)
    figure.savefig(buffer, format="png", metadata={"Software": None})
    write_atomic(path, buffer.getvalue())
    return path
