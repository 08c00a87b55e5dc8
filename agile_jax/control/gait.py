"""The gait clock: which feet stand when."""

import jax
import jax.numpy as jnp

from agile_jax.control.settings import GaitSettings

TROT_OFFSETS = (0.0, 0.5, 0.5, 0.0)  # FR, FL, RR, RL, as fractions of the period


def phase(settings: GaitSettings, time: jax.Array) -> jax.Array:
    """Phase of each leg in [0, 1): it stands while below `duty`, then swings. Shape (...) to (..., 4)."""
    return jnp.mod(time[..., None] / settings.period + jnp.array(TROT_OFFSETS), 1.0)


def stance(settings: GaitSettings, time: jax.Array) -> jax.Array:
    """Whether each foot stands at `time`. Shape (...) to (..., 4), boolean."""
    return phase(settings, time) < settings.duty


def landings(settings: GaitSettings, start: jax.Array, time: jax.Array) -> jax.Array:
    """How often each foot lands after `start` up to `time`. Shape (...) to (..., 4)."""

    def cycles(moment: jax.Array) -> jax.Array:
        return jnp.floor(moment[..., None] / settings.period + jnp.array(TROT_OFFSETS))

    return cycles(time) - cycles(start)


def swing_progress(settings: GaitSettings, time: jax.Array) -> jax.Array:
    """Progress of each swing in [0, 1]; 0 while standing. Shape (..., 4)."""
    return jnp.clip((phase(settings, time) - settings.duty) / (1 - settings.duty), 0.0, 1.0)


def swing_duration(settings: GaitSettings) -> float:
    """[s]."""
    return settings.period * (1 - settings.duty)


def stance_duration(settings: GaitSettings) -> float:
    """[s]."""
    return settings.period * settings.duty
