"""Settings of the policy: what the field is."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, SerializeAsAny, WrapValidator

from agile_jax.plugins import by_kind, one_of
from agile_jax.settings import Count, Positive, Settings

HiddenLayers = Annotated[tuple[Count, ...], Field(strict=False, min_length=1)]
POLICIES = ("plain", "residual", "feedback")


class PolicySettings(Settings):
    """The velocity field s -> s', or with kind = "feedback" the law (s, s') -> s'' (feedback.py).

    The paper's: kind = "plain", hidden_layers = [256, 1024, 1024, 1024, 1024, 256], activation = "tanh",
    normalize_inputs = false. It names no feature but the pose. What stands below `normalize_inputs` belongs to the
    residual field (field.py) and the feedback law, and changes nothing in the plain field.
    """

    kind: Annotated[str, AfterValidator(one_of("policy", *POLICIES)), Field(examples=list(POLICIES))] = "residual"
    """plain: the paper's network. residual: a network on top of a braking law. feedback: accelerations from pose and
    rates. Or one of a plugin (docs/extending.md).
    """
    hidden_layers: HiddenLayers = (128, 128, 128)
    """Widths of the network's hidden layers."""
    activation: Literal["tanh", "softplus", "gelu", "relu"] = "tanh"
    """Nonlinearity between the layers."""
    normalize_inputs: bool = True
    """Shift and scale the inputs to mean 0 and deviation 1 over the training samples."""
    wall_features: bool = True
    """Signed distances to the obstacles' faces as further inputs."""
    wall_length: Positive = 0.15
    """Distance over which these inputs saturate [m]."""
    blend_time: Positive = 0.15
    """Time to go below which the network fades out [s]."""
    approach_rate: Positive = 8.0
    """Rate of the last centimetres' approach, 1 / time constant [1/s]."""
    field_filter: bool = True
    """Limit the speed towards obstacles to what can be braked (speed_filter.py)."""
    filter_margin: Positive = 0.02
    """Clearance below which the field no longer approaches [m]; less than the labels' expert.clearance_margin."""


AnyPolicy = Annotated[SerializeAsAny[PolicySettings], WrapValidator(by_kind("policy", *POLICIES))]
