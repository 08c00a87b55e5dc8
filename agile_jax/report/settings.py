"""Settings of the report: whether and how the video is rendered."""

from typing import Annotated, Literal

from pydantic import Field

from agile_jax.settings import Positive, Settings

EvenPixels = Annotated[int, Field(ge=64, le=3840, multiple_of=2)]  # the video's colour planes have half the resolution


class ReportSettings(Settings):
    """What the report shows beyond its tables and figures."""

    video: bool = True
    renderer: Literal["auto", "opengl", "drawing"] = "auto"  # auto: OpenGL where it works, else the drawing
    width: EvenPixels = 640  # [pixel]
    height: EvenPixels = 360  # [pixel]
    frames_per_second: Annotated[int, Field(ge=1, le=50)] = 25  # traces hold 50 states a second
    longest_video: Positive = 15.0  # [s] of the episode
    paths_start: Annotated[tuple[float, float], Field(strict=False)] = (0.0, 0.0)  # the paper's figure 2 [m]
