"""Settings of the dataset: how trajectories are split, and which of their nodes are samples."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from agile_jax.settings import Fraction, NonNegative, Settings


class DatasetSettings(Settings):
    """The split is by trajectory: neighbours on one trajectory are nearly equal and must not sit on both sides of
    it.

    `split_by = "sample"` and `target = "displacement"` are readings of a paper that leaves both open (docs/results.md).
    """

    split: Annotated[tuple[Fraction, Fraction, Fraction], Field(strict=False)] = (0.8, 0.1, 0.1)
    """Shares of the trajectories for training, validation and test [-]; they add up to 1."""
    split_by: Literal["trajectory", "sample"] = "trajectory"
    """What is split. sample: a reading of the paper that shows what a leak hides; not to be trusted."""
    target: Literal["velocity", "displacement"] = "velocity"
    """What the policy learns: the velocity at a pose, or the displacement to the next node (0 at the last) [m, rad]."""
    samples: Literal["all", "without_start"] = "all"
    """Which nodes of a trajectory are samples: all, or those after `start_seconds`."""
    start_seconds: NonNegative = 0.6
    """Time left out by samples = "without_start" [s]: speeding up from rest is not a function of the pose."""

    @model_validator(mode="after")
    def _split_adds_up(self) -> "DatasetSettings":
        if abs(sum(self.split) - 1) > 1e-9:
            raise ValueError(f"split = {list(self.split)} must add up to 1 (train, validation, test)")
        return self
