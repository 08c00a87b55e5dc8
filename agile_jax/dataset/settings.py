"""Settings of the dataset: how many trajectories, from where and to where, how they are split, and which of their nodes
are samples."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from agile_jax.settings import Count, Fraction, NonNegative, Pose, Positive, Settings


class DatasetSettings(Settings):
    """The split is by trajectory: neighbours on one trajectory are nearly equal and must not sit on both sides of
    it.

    `split_by = "sample"` and `label_kind = "displacement"` are readings of a paper that leaves both open
    (docs/results.md).
    """

    trajectories: Count = 400
    """Number of labels: optimal trajectories. More of them leave those that are there as they are."""
    targets: Annotated[tuple[Pose, ...], Field(strict=False)] = ()
    """Poses [m, rad] that the labels lead to, in turn: label i to number i modulo their count; without any, to the
    scene's target.
    """
    shard_size: Count = 50
    """Number of trajectories in a file."""
    starts: Literal["paper", "wide"] = "paper"
    """Where labels start. paper: the distribution of scene.start. wide: that and everywhere the robot may get to
    (dataset/starts.py).
    """
    wide_paper_fraction: Fraction = 0.35
    """Share of the wide starts that is drawn as the paper's, but at any height [-]."""
    wide_target_fraction: Fraction = 0.15
    """Share of the wide starts that is drawn around the target [-]."""
    wide_target_std: Positive = 0.4
    """Standard deviation in the plane of the wide starts around the target [m]."""
    wide_yaw_std: NonNegative = 0.4
    """Standard deviation of the wide starts' yaw about the target's [rad]."""
    wide_padding: NonNegative = 0.5
    """Padding of the box around starts, obstacles and target over which wide starts are drawn [m]."""
    split: Annotated[tuple[Fraction, Fraction, Fraction], Field(strict=False)] = (0.8, 0.1, 0.1)
    """Shares of the trajectories for training, validation and test [-]; they add up to 1."""
    split_by: Literal["trajectory", "sample"] = "trajectory"
    """What is split. sample: a reading of the paper that shows what a leak hides; not to be trusted."""
    label_kind: Literal["velocity", "displacement"] = "velocity"
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
