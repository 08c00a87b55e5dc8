"""The optimiser and the learning rate's schedule by name, as pure functions of the step."""

from collections.abc import Callable

import optax

from agile_jax.training.settings import WITH_MOMENTUM, WITH_WEIGHT_DECAY, TrainingSettings

SCHEDULES: dict[str, Callable[[float, float, int], optax.Schedule]] = {  # (first rate, last over first, steps)
    "constant": lambda rate, _, steps: optax.constant_schedule(rate),
    "cosine": lambda rate, final, steps: optax.cosine_decay_schedule(rate, steps, alpha=final),
    "cosine_onecycle": lambda rate, _, steps: optax.cosine_onecycle_schedule(steps, rate),
    "exponential": lambda rate, final, steps: optax.exponential_decay(rate, steps, final),
    "linear": lambda rate, final, steps: optax.linear_schedule(rate, final * rate, steps),
    "linear_onecycle": lambda rate, _, steps: optax.linear_onecycle_schedule(steps, rate),
    "polynomial": lambda rate, final, steps: optax.polynomial_schedule(rate, final * rate, 2, steps),
}


def make_schedule(settings: TrainingSettings, steps: int) -> optax.Schedule:
    """The learning rate by step, of `steps` altogether: a linear warm-up from 0, then the schedule over the rest."""
    warm = round(settings.warmup * steps)
    schedule = SCHEDULES[settings.schedule](settings.learning_rate, settings.final_rate, max(steps - warm, 1))
    if warm == 0:
        return schedule
    return optax.join_schedules([optax.linear_schedule(0.0, settings.learning_rate, warm), schedule], [warm])


def make_optimizer(settings: TrainingSettings, steps: int) -> optax.GradientTransformation:
    """The optimiser for a training of `steps` steps: Optax's of that name, with what it takes of the settings."""
    name, options = settings.optimizer, dict[str, float | bool | None]()
    if name in WITH_WEIGHT_DECAY:
        options["weight_decay"] = settings.weight_decay
    if name in WITH_MOMENTUM:
        # None switches off, but in lars; a momentum of 0 would keep a copy of the gradient for nothing.
        options["momentum"] = settings.momentum if name == "lars" else settings.momentum or None
        options["nesterov"] = settings.nesterov
    optimizer: optax.GradientTransformation = getattr(optax, name)(make_schedule(settings, steps), **options)
    if settings.clip_norm is None:
        return optimizer
    return optax.chain(optax.clip_by_global_norm(settings.clip_norm), optimizer)
