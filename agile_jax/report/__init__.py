"""The report of a run: figures, video and one HTML file that stands alone.

Matplotlib, Pillow and the video encoder live here."""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names
from agile_jax.report.settings import ReportSettings

if TYPE_CHECKING:
    from agile_jax.report.figures.path_axes import plot_path
    from agile_jax.report.figures.plan_figures import draw_plan
    from agile_jax.report.html import write_report
    from agile_jax.report.video.rendering_record import rendering_notes
    from agile_jax.report.video.video import render_video

__all__ = ["ReportSettings", "draw_plan", "plot_path", "render_video", "rendering_notes", "write_report"]

__getattr__ = lazy_names(
    __name__,
    {
        "html": "write_report",
        "video.rendering_record": "rendering_notes",
        "figures.path_axes": "plot_path",
        "figures.plan_figures": "draw_plan",
        "video.video": "render_video",
    },
)
