"""The optimiser and the learning rate's schedule, as pure functions of the step."""

import optax

from agile_jax.policy.settings import TrainingSettings


def make_schedule(settings: TrainingSettings, steps: int) -> optax.Schedule:
    """The learning rate by step, of `steps` altogether."""
    if settings.schedule == "cosine":
        return optax.cosine_decay_schedule(settings.learning_rate, steps, alpha=0.01)
    return optax.constant_schedule(settings.learning_rate)


def make_optimizer(settings: TrainingSettings, steps: int) -> optax.GradientTransformation:
    """The optimiser for a training of `steps` steps."""
    schedule = make_schedule(settings, steps)
    if settings.optimizer == "sgd":
        return optax.sgd(schedule)
    if settings.optimizer == "adam":
        return optax.adam(schedule)
    return optax.adamw(schedule, weight_decay=settings.weight_decay)
