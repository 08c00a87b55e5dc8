"""Settings of the policy (what the field is) and of its training."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

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


class ClosedLoopSettings(Settings):
    """The learner's own test: a kinematic robot follows the policy from starts that no training has seen.

    It may accelerate by the expert's bounds over `headroom`: a follower that has no more than its labels falls behind.
    """

    starts: Count = 256  # of the scene's distribution, after training
    headroom: Annotated[float, Field(gt=0, le=1)] = 0.92
    dt: Positive = 0.02  # tick [s]
    every: Annotated[int, Field(ge=0)] = 25  # epochs between two looks during training; 0: none
    watched_starts: Count = 256  # of each look, others than those after training


class DaggerSettings(Settings):
    """Rounds of dataset aggregation (Ross, Gordon and Bagnell, AISTATS 2011), from the training's own rollouts.

    A round rolls the policy out, asks the expert at poses on the way to the least clearances, adds its paths to the
    training samples, and goes on training.
    """

    rounds: Annotated[int, Field(ge=0)] = 0
    starts: Count = 2000  # rolled out in each round
    queries: Count = 400  # poses in each round
    epochs: Count = 20  # of each round's training
    rate: Annotated[float, Field(gt=0, le=1)] = 0.3  # its learning rate over training.learning_rate


class TrainingSettings(Settings):
    """How the network is fitted. The paper's: optimizer = "sgd", learning_rate = 0.5, batch_size = 1024, epochs = 20.

    The paper's rate diverges with initialisation = "lecun_normal" on raw inputs and converges with "torch_uniform",
    the default of the framework that such recipes usually come from.
    """

    optimizer: Literal["sgd", "adam", "adamw"] = "adam"
    learning_rate: Positive = 2e-3
    schedule: Literal["constant", "cosine"] = "cosine"  # cosine: to a hundredth of the rate at the last step
    weight_decay: Annotated[float, Field(ge=0)] = 0.0  # of adamw
    batch_size: Count = 512
    epochs: Count = 150
    loss: Literal["mse"] = "mse"  # in (m/s)^2 and (rad/s)^2, averaged over the outputs
    initialisation: Literal["lecun_normal", "torch_uniform"] = "lecun_normal"  # torch_uniform: +-1 / sqrt(fan in)
    precision: Literal["float32", "tensorfloat32", "bfloat16"] = (
        "float32"  # of matrix products; a CPU always uses float32
    )
    checkpoint_every: Count = 10  # epochs
    keep: Annotated[int, Field(ge=2)] = 2  # checkpoints kept, so that there is one before a damaged one

    @model_validator(mode="after")
    def _weight_decay_is_used(self) -> "TrainingSettings":
        if self.weight_decay > 0 and self.optimizer != "adamw":
            raise ValueError(
                f'weight_decay = {self.weight_decay} has no effect with optimizer = "{self.optimizer}"; use "adamw"'
            )
        return self
