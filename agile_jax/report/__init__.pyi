"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .figures.episode_figures import episode_figure as episode_figure
from .figures.plan_figures import draw_plan as draw_plan, plan_figure as plan_figure
from .figures.style import new_axes as new_axes, save_figure as save_figure
from .html import write_report as write_report
from .outdated import mark_outdated as mark_outdated
from .settings import ReportSettings as ReportSettings
from .study_page import write_study_page as write_study_page
from .video.rendering_record import rendering_notes as rendering_notes
from .video.video import render_video as render_video
