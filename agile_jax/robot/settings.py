"""Settings of the robot."""

import string
from typing import Annotated

from pydantic import Field, field_validator

from agile_jax.settings import Settings

Names3 = Annotated[tuple[str, str, str], Field(strict=False)]
Names4 = Annotated[tuple[str, str, str, str], Field(strict=False)]

OWN = "a1"


class RobotSettings(Settings):
    """Which robot: "a1", the Unitree A1, 12.453 kg, twelve torque-controlled joints (robot/a1.xml), or an MJCF's path.

    Another robot has a free trunk and four legs of three joints: abad about x, hip and knee about y, the knee bending
    backward, the leg hanging straight down at zero angles (robot/mjcf.py).
    """

    name: Annotated[str, Field(min_length=1)] = OWN
    """The Unitree A1 ("a1"), or the path of an MJCF file, relative to the experiment file that sets it."""
    legs: Names4 = ("FR", "FL", "RR", "RL")
    """Names of front right, front left, rear right and rear left leg of another robot."""
    joints: Names3 = ("{leg}_hip_joint", "{leg}_thigh_joint", "{leg}_calf_joint")
    """Names of abad, hip and knee joint of another robot, with {leg} in place of the leg's name."""

    @field_validator("joints")
    @classmethod
    def _joints_name_their_leg(cls, joints: tuple[str, str, str]) -> tuple[str, str, str]:
        for joint in joints:
            try:
                fields = {field for _, field, _, _ in string.Formatter().parse(joint) if field is not None}
            except ValueError:
                fields = set()
            if fields != {"leg"}:
                raise ValueError(
                    f"{joint!r} must contain {{leg}}, in whose place the leg's name is put, and no other braces"
                )
        return joints

    @field_validator("legs")
    @classmethod
    def _legs_differ(cls, legs: tuple[str, str, str, str]) -> tuple[str, str, str, str]:
        if len(set(legs)) < len(legs):
            raise ValueError(f"{list(legs)} must be four different names")
        return legs
