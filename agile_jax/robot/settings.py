"""Settings of the robot."""

from typing import Literal

from agile_jax.settings import Settings


class RobotSettings(Settings):
    """Which robot. "a1": the Unitree A1, 12.453 kg, twelve torque-controlled joints (robot/a1.xml)."""

    name: Literal["a1"] = "a1"
