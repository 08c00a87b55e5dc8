"""The report of a run: figures, video and one self-contained HTML file. Matplotlib, Pillow and imageio live here.

Names are loaded when first used, so that reading the settings does not load Matplotlib.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from agile_jax.report.settings import ReportSettings

if TYPE_CHECKING:
    from agile_jax.report.html import write_report
    from agile_jax.report.plan_figures import draw_plan
    from agile_jax.report.video import render_video

__all__ = ["ReportSettings", "draw_plan", "render_video", "write_report"]

_HOMES = {"draw_plan": "plan_figures", "render_video": "video", "write_report": "html"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
