"""Settings of the evaluation."""

from typing import Annotated, Literal

from pydantic import Field

from agile_jax.settings import Count, Settings


class EvaluationSettings(Settings):
    """Closed-loop episodes from starts of the scene's distribution that no training has seen."""

    episodes: Count = 64
    backend: Literal["mujoco", "mjx"] = "mujoco"
    batch: Count = 64  # episodes simulated at once; does not change their results
    seed: Annotated[int, Field(ge=0)] = 0  # of the starts, beside the experiment's own
    traced: Annotated[int, Field(ge=0)] = 8  # episodes recorded for figures and videos
