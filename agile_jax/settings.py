"""What every stage's settings share: strict, frozen models, and the one error for bad input."""

import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


class BadInput(ValueError):  # noqa: N818
    """Input that cannot be used. The text is complete: it names the file or key, the value, and what is allowed."""


class Settings(BaseModel):
    """Base of all settings: unknown keys, wrong types and NaN are refused; instances cannot change.

    The string below each field, with meaning and unit, is its text in `--help` and in the schema.
    """

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]


def yaw_error(yaw: float) -> str | None:
    """Why a yaw [rad] can be no one's intention: it is more than a full turn, so probably meant in degrees."""
    if abs(yaw) <= 2 * math.pi:
        return None
    return f"is more than a full turn [rad]; {yaw:g} degrees are {math.radians(yaw):.4g}"


def _within_a_turn(yaw: float) -> float:
    if error := yaw_error(yaw):
        raise ValueError(error)
    return yaw


Yaw = Annotated[float, AfterValidator(_within_a_turn)]

# TOML arrays are lists; strict mode would refuse them for a tuple.
Pose = Annotated[tuple[float, float, float, Yaw], Field(strict=False)]
PoseBound = Annotated[tuple[float, float, float, float], Field(strict=False)]
PositivePose = Annotated[tuple[Positive, Positive, Positive, Positive], Field(strict=False)]
NonNegativePose = Annotated[tuple[NonNegative, NonNegative, NonNegative, NonNegative], Field(strict=False)]
PositiveVector2 = Annotated[tuple[Positive, Positive], Field(strict=False)]
PositiveVector3 = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]
Vector2 = Annotated[tuple[float, float], Field(strict=False)]
Vector3 = Annotated[tuple[float, float, float], Field(strict=False)]
