"""Settings of the report: whether and how the video is rendered."""

from typing import Annotated, Literal

from pydantic import Field

from agile_jax.settings import Positive, Settings

EvenPixels = Annotated[int, Field(ge=64, le=3840, multiple_of=2)]  # the video's colour planes have half the resolution


class ReportSettings(Settings):
    """What the report shows beyond its tables and figures."""

    video: bool = True
    """Render a video of an episode."""
    renderer: Literal["auto", "opengl", "drawing"] = "auto"
    """What draws the video. auto: OpenGL where it works, else the drawing."""
    width: EvenPixels = 640
    """Width of the video [pixel]."""
    height: EvenPixels = 360
    """Height of the video [pixel]."""
    frames_per_second: Annotated[int, Field(ge=1, le=50)] = 25
    """Frames of the video in a second [1/s]; recordings hold 50 states a second."""
    longest_video: Positive = 15.0
    """Longest part of an episode that the video shows [s]."""
    paths_start: Annotated[tuple[float, float], Field(strict=False)] = (0.0, 0.0)
    """Start in the plane of the drawn paths, as in the paper's figure 2 [m]."""
