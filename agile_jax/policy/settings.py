"""Settings of the policy: what the field is."""

from typing import Annotated, Literal

from pydantic import Field

from agile_jax.settings import Count, Positive, Settings

HiddenLayers = Annotated[tuple[Count, ...], Field(strict=False, min_length=1)]


class PolicySettings(Settings):
    """The velocity field s -> s', or with kind = "feedback" the law (s, s') -> s'' (feedback.py).

    The paper's: kind = "plain", hidden_layers = [256, 1024, 1024, 1024, 1024, 256], activation = "tanh",
    normalize_inputs = false. It names no feature but the pose. What stands below `normalize_inputs` belongs to the
    residual field (field.py) and the feedback law, and changes nothing in the plain field.
    """

    kind: Literal["plain", "residual", "feedback"] = "residual"
    hidden_layers: HiddenLayers = (128, 128, 128)
    activation: Literal["tanh", "softplus", "gelu", "relu"] = "tanh"
    normalize_inputs: bool = True
    wall_features: bool = True  # signed distances to the faces of the obstacles, as inputs
    wall_length: Positive = 0.15  # distance over which they saturate [m]
    blend_time: Positive = 0.15  # time to go below which the network fades out [s]
    approach_rate: Positive = 8.0  # 1 / time constant of the last centimetres [1/s]
    field_filter: bool = True  # limit the speed towards obstacles to what can be braked (speed_limit.py)
    filter_margin: Positive = 0.02  # clearance below which the field no longer approaches; less than the labels' [m]
