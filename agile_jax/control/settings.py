"""Settings of the whole-body controller."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, SerializeAsAny, WrapValidator, model_validator

from agile_jax.plugins import by_kind, one_of
from agile_jax.settings import Count, NonNegative, Positive, PositiveVector3, Settings

NonNegativeVector3 = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]
CONTROLLERS = ("mpc",)


class GaitSettings(Settings):
    """Trot (diagonal legs together), walk (one leg at a time) and stand. Between two speeds values are interpolated."""

    period: Positive = 0.28
    """Period of the trot at `full_speed` and above [s]."""
    slow_period: Positive = 0.28
    """Period of the trot on the spot [s]."""
    shortest_period: Positive = 0.20
    """Period that the trot shortens to where the legs allow no longer stride, in a crouch at speed [s]; found on the A1
    from 0.12 to 0.17 m of trunk height, and scaled with the robot."""
    duty: Annotated[float, Field(gt=0, lt=1)] = 0.55
    """Fraction of the trot's period that a foot stands [-]."""
    walk_speed: NonNegative = 0.0
    """The robot walks where the reference is slower than this, else it trots; 0: it never walks [m/s]."""
    walk_period: Positive = 0.6
    """Period of the walk [s]."""
    walk_duty: Annotated[float, Field(gt=0.75, lt=1)] = 0.8
    """Fraction of the walk's period that a foot stands [-]; at 3/4 or less two feet would be in the air at once."""
    stand_speed: NonNegative = 0.03
    """The robot stands where the reference is slower than this; 0: it never stops stepping [m/s]."""
    step_height: Positive = 0.05
    """Lift of a foot at `full_speed` and above [m]."""
    slow_step_height: Positive = 0.05
    """Lift of a foot of a robot that steps on the spot [m]."""
    full_speed: Positive = 0.5
    """Speed from which period and lift are those of the fast trot [m/s]; below it they are interpolated."""
    headroom_fraction: Annotated[float, Field(gt=0, le=1)] = 0.4
    """Largest share of the lift that the knee's limit leaves (in an A1 trunk height - 0.108 m) that a step takes [-].
    """


class MpcSettings(Settings):
    """Convex model predictive control (Di Carlo et al. 2018). Weights are per node, in SI units, on squared errors."""

    horizon: Count = 10
    """Number of nodes of the prediction."""
    mpc_dt: Positive = 0.03
    """Time between two nodes [s]."""
    weight_orientation: PositiveVector3 = (20.0, 20.0, 10.0)
    """Weights of roll, pitch and yaw [1/rad^2]."""
    weight_position: PositiveVector3 = (20.0, 20.0, 100.0)
    """Weights of x, y and z [1/m^2]."""
    weight_angular_velocity: PositiveVector3 = (0.3, 0.3, 0.3)
    """Weights of the angular velocity about x, y and z [s^2/rad^2]."""
    weight_velocity: PositiveVector3 = (2.0, 2.0, 0.5)
    """Weights of the velocity along x, y and z [s^2/m^2]."""
    weight_force: Positive = 2e-5
    """Weight of each component of each foot's force [1/N^2]."""
    friction: Positive = 0.35
    """Coefficient of friction that the controller trusts [-]; below that of slippery floors (0.4)."""
    force_max: Positive = 200.0
    """Largest normal force of one foot [N]."""
    joint_margin: NonNegative = 0.01
    """Distance kept from the joints' position limits [rad]."""
    friction_cone: Literal["cone", "pyramid"] = "cone"
    """The exact second-order friction cone, or the pyramid inside it."""
    iterations: Count = 60
    """Largest number of iterations of the solver's first pass."""
    iterations_limits: Count = 70
    """Largest number of iterations of the solver's second pass, which also knows the joints' limits."""
    newton_steps: Count = 40
    """Largest number of steps of the solver's third pass, for what the first two leave."""
    tolerance: Positive = 0.003
    """Largest residual of a solved problem [N]."""


class ControlSettings(Settings):
    """Whole-body control: gait, footholds, swing, MPC, torques."""

    kind: Annotated[str, AfterValidator(one_of("controller", *CONTROLLERS)), Field(examples=list(CONTROLLERS))] = "mpc"
    """Which controller: "mpc", or one of a plugin (docs/extending.md)."""
    gait: GaitSettings = GaitSettings()
    """When each foot stands, and how it swings."""
    mpc: MpcSettings = MpcSettings()
    """Prediction, weights and limits of the forces."""
    state: Literal["ideal", "estimated"] = "ideal"
    """What the controller knows of the robot's state: the truth, or an estimate from the sensors that [sensors]
    describes."""
    control_dt: Positive = 0.002
    """Time between two torques [s]."""
    plan_dt: Positive = 0.02
    """Time between two solutions of the MPC [s]; a multiple of `control_dt`."""
    scale_to_robot: bool = True
    """Scale gains, weights and gait, which are meant for the A1, by the robot's mass and leg length."""
    raibert_gain: NonNegative = 0.03
    """Shift of a foothold per velocity error [s]."""
    swing_stiffness: Positive = 60.0
    """Proportional gain of the joints of a swinging leg [Nm/rad]."""
    swing_damping: Positive = 1.5
    """Derivative gain of the joints of a swinging leg [Nm s/rad]."""
    integral_gain: NonNegativeVector3 = (4.0, 2.0, 4.0)
    """Gains of the integrals of the errors in z, roll and pitch [1/s]. They are added to the reference and make up for
    what the single rigid body leaves out (moving legs).
    """
    integral_limit: PositiveVector3 = (0.03, 0.15, 0.15)
    """Largest corrections by these integrals in z, roll and pitch [m, rad, rad]."""
    lead_limit: PositiveVector3 = (0.05, 0.03, 0.15)
    """How far the reference may lead the robot: in the plane, in height, in yaw [m, m, rad]."""

    @model_validator(mode="after")
    def _clocks_agree(self) -> "ControlSettings":
        ratio = self.plan_dt / self.control_dt
        if abs(ratio - round(ratio)) > 1e-9 or ratio < 1:
            raise ValueError(f"plan_dt = {self.plan_dt} must be a multiple of control_dt = {self.control_dt}")
        return self


AnyControl = Annotated[SerializeAsAny[ControlSettings], WrapValidator(by_kind("controller", *CONTROLLERS))]
