"""Settings of the expert: bounds, margins, transcription."""

from typing import Annotated, Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float
from pydantic import AfterValidator, Field, SerializeAsAny, WrapValidator

from agile_jax.plugins import by_kind, one_of
from agile_jax.settings import BadInput, Count, NonNegative, PositivePose, Settings

EXPERTS = ("minimum_time",)
InitialVelocity = Literal["rest", "free"]  # at rest, or the best velocity within the bounds


def checked_initial_velocity(value: str) -> InitialVelocity:
    """The initial velocity that a word stands for (BadInput where it is none)."""
    for choice in get_args(InitialVelocity):
        if value == choice:
            return choice
    raise BadInput(f'initial_velocity = {value!r}: must be "rest" or "free"')


class MotionLimits(NamedTuple):
    """Bounds of the rates and accelerations of the pose [x, y, z, yaw], axis by axis."""

    velocity: Float[np.ndarray, "4"]  # [m/s, rad/s]
    acceleration: Float[np.ndarray, "4"]  # [m/s^2, rad/s^2]


class ExpertSettings(Settings):
    """The optimal control problem of the paper (equation 2), and its transcription.

    The paper gives no bounds, no margin and no effort weight. The defaults are what a trotting A1 can track. Rates
    and accelerations are of [x, y, z, yaw].
    """

    kind: Annotated[str, AfterValidator(one_of("expert", *EXPERTS)), Field(examples=list(EXPERTS))] = "minimum_time"
    """Which expert: "minimum_time", or one of a plugin (docs/extending.md)."""
    nodes: Annotated[int, Field(ge=10, le=2000)] = 100
    """Number of intervals of a trajectory."""
    velocity: PositivePose = (1.0, 0.5, 0.3, 1.0)
    """Bounds of the rates of [x, y, z, yaw] [m/s, rad/s]."""
    acceleration: PositivePose = (1.5, 1.5, 1.0, 3.0)
    """Bounds of the accelerations of [x, y, z, yaw] [m/s^2, rad/s^2]."""
    clearance_margin: NonNegative = 0.025
    """Clearance that a plan keeps from obstacles, epsilon of equation 2 [m]."""
    initial_velocity: InitialVelocity = "rest"
    """How labels begin. rest: as in the paper. free: with the best velocity within the bounds."""
    effort_weight: Annotated[float, Field(gt=0, le=1)] = 5e-3
    """Weight of the integral of sum (u_i / a_i)^2 in the objective [-]; it makes labels unique (expert/__init__.py)."""
    transcription: Literal["zoh", "foh", "trapezoidal"] = "zoh"
    """Piecewise-constant acceleration, piecewise-linear acceleration (Hermite-Simpson), or trapezoidal collocation."""
    velocity_bound: Literal["axis", "planar_norm"] = "axis"
    """axis: |v_i| <= velocity_i. planar_norm: in the plane (v_x / velocity_x)^2 + (v_y / velocity_y)^2 <= 1."""
    zero_end_controls: bool = False
    """The paper's u_0 = u_N = 0; costs 2 / nodes of the time (zoh), else 1 / nodes."""
    dimensions: Literal["3d", "2d"] = "3d"
    """2d: the height stays the target's, and obstacles reach up from the floor (the paper's figure 2)."""
    method: Literal["auto", "general"] = "auto"
    """auto: the closed-form least time where it is attained, else the general program. general: always that program."""
    edges: Literal["rounded", "square"] = "rounded"
    """How the general program keeps the margin around obstacles' edges. rounded: exactly. square: within the fast
    path's square corners, whose diagonal is up to sqrt(2) margins away.
    """
    max_routes: Count = 24
    """Largest number of routes that the general program solves for one start."""

    @property
    def limits(self) -> MotionLimits:
        """The bounds of velocity and acceleration as arrays."""
        return MotionLimits(np.array(self.velocity), np.array(self.acceleration))


AnyExpert = Annotated[SerializeAsAny[ExpertSettings], WrapValidator(by_kind("expert", *EXPERTS))]
