"""Settings of the robot."""

import string
from typing import Annotated

from pydantic import AfterValidator, Field, field_validator

from agile_jax.settings import NonNegative, Positive, Settings

Names3 = Annotated[tuple[str, str, str], Field(strict=False)]
Names4 = Annotated[tuple[str, str, str, str], Field(strict=False)]

OWN = "a1"


def _ordered(value: float | tuple[float, float]) -> float | tuple[float, float]:
    if isinstance(value, tuple) and value[0] > value[1]:
        raise ValueError(f"{list(value)}: the lower end of a range comes first")
    return value


# A number, or a range [low, high] from which every episode draws its own.
FactorRange = Annotated[
    NonNegative | Annotated[tuple[NonNegative, NonNegative], Field(strict=False)], AfterValidator(_ordered)
]
PositiveRange = Annotated[
    Positive | Annotated[tuple[Positive, Positive], Field(strict=False)], AfterValidator(_ordered)
]
LengthRange = Annotated[float | Annotated[tuple[float, float], Field(strict=False)], AfterValidator(_ordered)]


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


class PlantSettings(Settings):
    """How the simulated robot differs from the one that the controller is told. Every value but `com_shift`, and every
    component of that, is a number or a range [low, high], from which each episode draws uniformly.
    """

    joint_damping: FactorRange = 1.0
    """Factor on the damping of all joints [-]."""
    joint_friction: FactorRange = 1.0
    """Factor on the dry friction of all joints [-]."""
    armature: FactorRange = 1.0
    """Factor on the inertia of all rotors [-]."""
    mass: PositiveRange = 1.0
    """Factor on the mass and the inertia of the trunk [-]."""
    com_shift: Annotated[tuple[LengthRange, LengthRange, LengthRange], Field(strict=False)] = (0.0, 0.0, 0.0)
    """Shift of the trunk's centre of mass along its axes [m]."""
    foot_friction: PositiveRange | None = None
    """Coefficient of friction of the feet [-]; without a value that of the robot's file (A1: 0.8)."""
    delay: FactorRange = 0.0
    """Time from a torque's command to its effect, rounded to `control.control_dt` [s]."""
    push_impulse: FactorRange = 0.0
    """Impulse of one horizontal push on the trunk, in a direction that each episode draws [N s]: below an obstacle or,
    where the expert's path goes under none, at half the expert's time (simulation/pushes.py).
    """
    no_load_speed: PositiveRange | None = None
    """Speed at which the motors give no torque any more: the limit falls linearly from half of it on [rad/s]. Without a
    value the limit is the same at every speed.
    """


class SensorSettings(Settings):
    """What the robot knows of itself with `control.state = "estimated"`: standard deviations of normal errors. Noise is
    drawn anew at each sample, biases once an episode. Sampled every `control.control_dt`.

    IMU: one for hobbyists. The MPU-6050's data sheet says 0.005 deg/s/sqrt(Hz) and 400 ug/sqrt(Hz), over 260 Hz 0.0014
    rad/s and 0.06 m/s^2; here more, since legs shake it. Biases are what zeroing at rest leaves of its 20 deg/s and 50
    mg. It sits in the trunk's origin, as the A1's does.
    """

    gyro_noise: NonNegative = 0.005
    """Noise of the gyroscope [rad/s]."""
    gyro_bias: NonNegative = 0.003
    """Bias of the gyroscope [rad/s]."""
    accelerometer_noise: NonNegative = 0.1
    """Noise of the accelerometer [m/s^2]."""
    accelerometer_bias: NonNegative = 0.1
    """Bias of the accelerometer [m/s^2]."""
    encoder_noise: NonNegative = 0.001
    """Noise of the joints' angles, their resolution included [rad]; as Bloesch et al. (2012) have."""
    encoder_bias: NonNegative = 0.003
    """Error of the joints' zeros [rad]."""
    joint_velocity_noise: NonNegative = 0.1
    """Noise of the joints' velocities [rad/s]."""
    delay: NonNegative = 0.002
    """Age of what the sensors tell, rounded to `control.control_dt` [s]."""
    localisation_rate: NonNegative = 0.0
    """How often something else, such as cameras on the walls, tells x, y and yaw [1/s]. 0: never; they are counted from
    the start on, which is known."""
    localisation_noise: Annotated[tuple[NonNegative, NonNegative], Field(strict=False)] = (0.01, 0.01)
    """Noise of what it tells: x and y [m], yaw [rad]."""
