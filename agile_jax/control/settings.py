"""Settings of the whole-body controller."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from agile_jax.settings import Count, NonNegative, Positive, PositiveVector3, Settings

NonNegativeVector3 = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]


class GaitSettings(Settings):
    """Trot (diagonal legs together), walk (one leg at a time) and stand. Between two speeds values are interpolated."""

    period: Positive = 0.28  # of the trot, at full_speed and above [s]
    slow_period: Positive = 0.28  # of the trot, stepping on the spot [s]
    duty: Annotated[float, Field(gt=0, lt=1)] = 0.55  # fraction of the period that a foot stands, trotting
    walk_speed: NonNegative = (
        0.0  # the robot walks where the reference is slower, else it trots; 0: it never walks [m/s]
    )
    walk_period: Positive = 0.6  # [s]
    walk_duty: Annotated[float, Field(gt=0.75, lt=1)] = 0.8  # above 3/4, or two feet would be in the air at once
    stand_speed: NonNegative = (
        0.03  # it stands where the reference is slower than this; 0: it never stops stepping [m/s]
    )
    step_height: Positive = 0.05  # lift of a foot at full_speed and above [m]
    slow_step_height: Positive = 0.05  # the same, stepping on the spot [m]
    full_speed: Positive = 0.5  # [m/s]
    # The knee's limit leaves (trunk height - 0.108 m) of lift in an A1; a step takes at most this share of it.
    headroom_fraction: Annotated[float, Field(gt=0, le=1)] = 0.4


class MpcSettings(Settings):
    """Convex model predictive control (Di Carlo et al. 2018). Weights are per node, in SI units, on squared errors."""

    horizon: Count = 10  # nodes
    mpc_dt: Positive = 0.03  # between nodes [s]
    weight_orientation: PositiveVector3 = (20.0, 20.0, 10.0)  # roll, pitch, yaw
    weight_position: PositiveVector3 = (20.0, 20.0, 100.0)
    weight_angular_velocity: PositiveVector3 = (0.3, 0.3, 0.3)
    weight_velocity: PositiveVector3 = (2.0, 2.0, 0.5)
    weight_force: Positive = 2e-5
    friction: Positive = 0.35  # coefficient that the controller trusts; below that of slippery floors (0.4)
    force_max: Positive = 200.0  # normal force of one foot [N]
    joint_margin: NonNegative = 0.01  # kept from the joints' position limits [rad]
    friction_cone: Literal["cone", "pyramid"] = "cone"  # the exact second-order cone, or the pyramid inside it
    iterations: Count = 60  # at most, of the solver's first pass
    iterations_limits: Count = 70  # at most, of its second pass, which also knows the joints' limits
    newton_steps: Count = 40  # at most, of its third pass, for what these leave
    tolerance: Positive = 0.003  # largest residual of a solved problem [N]


class ControlSettings(Settings):
    """Whole-body control: gait, footholds, swing, MPC, torques."""

    gait: GaitSettings = GaitSettings()
    mpc: MpcSettings = MpcSettings()
    control_dt: Positive = 0.002  # between torques [s]
    plan_dt: Positive = 0.02  # between solutions of the MPC [s]
    scale_to_robot: bool = True  # gains, weights and gait are meant for the A1: scale them by mass and leg length
    raibert_gain: NonNegative = 0.03  # foothold shift per velocity error [s]
    knee_clearance: Positive = 0.045  # height of the knees' centres over the floor that footholds must leave [m]
    swing_stiffness: Positive = 60.0  # joint PD of the swing legs [Nm/rad]
    swing_damping: Positive = 1.5  # [Nm s/rad]
    # Integral of the height, roll and pitch errors, added to the reference: what the single rigid body leaves out
    # (moving legs).
    integral_gain: NonNegativeVector3 = (4.0, 2.0, 4.0)  # z, roll, pitch [1/s]
    integral_limit: PositiveVector3 = (0.03, 0.15, 0.15)  # [m], [rad], [rad]
    # How far the reference may lead the robot: in the plane [m], in height [m], in yaw [rad].
    leash: PositiveVector3 = (0.05, 0.03, 0.15)

    @model_validator(mode="after")
    def _clocks_agree(self) -> "ControlSettings":
        ratio = self.plan_dt / self.control_dt
        if abs(ratio - round(ratio)) > 1e-9 or ratio < 1:
            raise ValueError(f"plan_dt = {self.plan_dt} must be a multiple of control_dt = {self.control_dt}")
        return self
