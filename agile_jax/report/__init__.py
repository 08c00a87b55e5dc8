"""The report of a run: figures, video and one HTML file that stands alone.

Figures are drawn on Matplotlib's Axes (`draw_...`) or are a Figure of several (`..._figure`); `save_figure` writes one.
Matplotlib, Pillow and the video encoder live here."""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names
from agile_jax.report.settings import ReportSettings

if TYPE_CHECKING:
    from agile_jax.report.figures.episode_figures import episode_figure
    from agile_jax.report.figures.plan_figures import draw_plan, plan_figure
    from agile_jax.report.figures.style import new_axes, save_figure
    from agile_jax.report.html import write_report
    from agile_jax.report.outdated import mark_outdated
    from agile_jax.report.video.rendering_record import rendering_notes
    from agile_jax.report.video.video import render_video

__all__ = [
    "ReportSettings",
    "draw_plan",
    "episode_figure",
    "mark_outdated",
    "new_axes",
    "plan_figure",
    "render_video",
    "rendering_notes",
    "save_figure",
    "write_report",
]

__getattr__ = lazy_names(
    __name__,
    {
        "html": "write_report",
        "outdated": "mark_outdated",
        "video.rendering_record": "rendering_notes",
        "figures.episode_figures": "episode_figure",
        "figures.plan_figures": "draw_plan plan_figure",
        "figures.style": "new_axes save_figure",
        "video.video": "render_video",
    },
)
