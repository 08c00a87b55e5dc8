"""Settings of the training: the fit, the kinematic test, and the rounds of aggregation."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from agile_jax.settings import Count, NonNegative, Positive, Settings


class KinematicTestSettings(Settings):
    """The learner's own test: a kinematic robot follows the policy from starts that no training has seen.

    It may accelerate by the expert's bounds over `headroom`: a follower that has no more than its labels falls behind.
    """

    starts: Count = 256
    """Number of starts of the scene's distribution that are followed after the training."""
    headroom: Annotated[float, Field(gt=0, le=1)] = 0.92
    """The expert's bounds of acceleration over the follower's [-]."""
    dt: Positive = 0.02
    """Time step of the test [s]."""
    every: Annotated[int, Field(ge=0)] = 25
    """Number of epochs between two looks during the training; 0: none."""
    watched_starts: Count = 256
    """Number of starts of each look, others than those after the training."""


class AggregationSettings(Settings):
    """Rounds of dataset aggregation (Ross, Gordon and Bagnell, AISTATS 2011), from the training's own rollouts.

    A round rolls the policy out, asks the expert at poses on the way to the least clearances, adds its paths to the
    training samples, and goes on training.
    """

    rounds: Annotated[int, Field(ge=0)] = 0
    """Number of rounds; 0: no aggregation."""
    starts: Count = 2000
    """Number of starts that are rolled out in each round."""
    queries: Count = 400
    """Number of poses about which the expert is asked in each round."""
    epochs: Count = 20
    """Number of epochs of each round's training."""
    rate: Annotated[float, Field(gt=0, le=1)] = 0.3
    """Learning rate of the rounds over training.learning_rate [-]."""


Optimizer = Literal[
    "adabelief",
    "adadelta",
    "adafactor",
    "adagrad",
    "adam",
    "adamax",
    "adamaxw",
    "adamw",
    "adan",
    "amsgrad",
    "lamb",
    "lars",
    "lion",
    "nadam",
    "nadamw",
    "novograd",
    "radam",
    "rmsprop",
    "sgd",
    "sign_sgd",
    "yogi",
]
Schedule = Literal["constant", "cosine", "cosine_onecycle", "exponential", "linear", "linear_onecycle", "polynomial"]
WITH_MOMENTUM = ("lars", "rmsprop", "sgd")
WITH_WEIGHT_DECAY = ("adamaxw", "adamw", "adan", "lamb", "lars", "lion", "nadamw", "novograd")


class TrainingSettings(Settings):
    """How the network is fitted. The paper's: optimizer = "sgd", learning_rate = 0.5, batch_size = 1024, epochs = 20.

    The paper's rate diverges with initialisation = "lecun_normal" on raw inputs and converges with "torch_uniform",
    the default of the framework that such recipes usually come from. Optimisers and schedules are Optax's of the same
    name (optimizer.py); left out are those that need more than a gradient (line searches), take no schedule (sm3,
    rprop) or add noise.
    """

    optimizer: Optimizer = "adam"
    """Optimiser, by Optax's name."""
    learning_rate: Positive = 2e-3
    """Initial learning rate; of a one-cycle schedule the highest."""
    momentum: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Momentum of sgd, rmsprop and lars [-]."""
    nesterov: bool = False
    """Nesterov's momentum in sgd, rmsprop and lars."""
    weight_decay: NonNegative = 0.0
    """Weight decay of adamaxw, adamw, adan, lamb, lars, lion, nadamw and novograd."""
    clip_norm: Positive | None = None
    """Largest norm of the whole gradient; without it, any."""
    schedule: Schedule = "cosine"
    """How the learning rate goes from `learning_rate` to `final_rate` of it at the last step."""
    final_rate: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Learning rate at the last step over `learning_rate` [-]; not of constant and one-cycle schedules."""
    warmup: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of all steps in which the learning rate rises from 0 [-]."""
    batch_size: Count = 512
    """Number of samples in a batch."""
    epochs: Count = 150
    """Number of passes over the training samples."""
    output_units: Literal["si", "std", "limits"] = "si"
    """Units of loss and outputs: SI, standard deviations of the labels, or the expert's bounds; only with policy.kind =
    "plain".
    """
    initialisation: Literal["glorot_uniform", "he_normal", "lecun_normal", "torch_uniform"] = "lecun_normal"
    """How weights begin. torch_uniform: +-1 / sqrt(fan in), biases, too."""
    precision: Literal["float32", "tensorfloat32", "bfloat16"] = "float32"
    """Precision of the wide layers' products (precision.py); parameters and the rest are float32."""
    seeds: Count = 1
    """Number of networks trained at once, with seeds seed, seed + 1, ...; the policy is the one with the least
    validation error.
    """
    devices: Count = 1
    """Number of JAX's devices that share each batch."""
    select: Literal["last", "best"] = "last"
    """Which parameters are kept: the last epoch's, or those of the epoch with the least validation error."""
    patience: Count | None = None
    """Number of epochs without a lower validation error after which the training stops; without it, never."""
    checkpoint_every: Count = 10
    """Number of epochs between two checkpoints."""
    keep: Annotated[int, Field(ge=2)] = 2
    """Number of checkpoints kept, so that there is one before a damaged one."""

    @model_validator(mode="after")
    def _has_an_effect(self) -> "TrainingSettings":
        """What the chosen optimiser, schedule or device count would ignore or cannot do is refused."""
        for name, known in (("momentum", WITH_MOMENTUM), ("weight_decay", WITH_WEIGHT_DECAY)):
            if getattr(self, name) > 0 and self.optimizer not in known:
                raise ValueError(
                    f'{name} = {getattr(self, name)} has no effect with optimizer = "{self.optimizer}"; '
                    f"it belongs to {', '.join(known)}"
                )
        if self.nesterov and self.momentum == 0:
            raise ValueError("nesterov = true has no effect without momentum; set momentum, for example to 0.9")
        if self.patience is not None and self.select != "best":
            raise ValueError(f'patience = {self.patience} stops after the best epoch: it needs select = "best"')
        if self.batch_size % self.devices:
            raise ValueError(f"batch_size = {self.batch_size} must be a multiple of devices = {self.devices}")
        return self
