"""The gait: which feet stand when, by the clock and by what they touch.

One phase in [0, 1) drives all legs, each with its own offset. The trot moves diagonal legs together. The walk moves
one leg at a time (rear right, front right, rear left, front left); it is the trot with the rear legs shifted by a
quarter, so that the two blend by shifting. The robot stands by stopping the phase where all feet are down (0 or 1/2),
and goes on from there.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from agile_jax.control.settings import GaitSettings

TROT_OFFSETS = (0.0, 0.5, 0.5, 0.0)  # FR, FL, RR, RL, as fractions of the period
WALK_SHIFT = (0.0, 0.0, -0.25, -0.25)
BLEND_TIME = 1.0  # from trot to walk or back [s]
GRACE = 0.05  # a foot that is late is still counted on that long: it is about to touch [s]


class Gait(NamedTuple):
    """State of the gait."""

    phase: Float[Array, ""]  # in [0, 1)
    walk: Float[Array, ""]  # 0: trot, 1: walk
    stand: Bool[Array, ""]  # stop where all feet are down
    period: Float[Array, ""]  # [s]
    # The foot has touched the ground since its last swing, or near the end of the present one.
    landed: Bool[Array, "4"]


def start(settings: GaitSettings) -> Gait:
    """The gait of a robot that stands with all feet down."""
    walk = jnp.float32(settings.walk_speed > 0)
    return Gait(jnp.float32(0.0), walk, jnp.bool_(True), jnp.float32(settings.period), jnp.ones(4, bool))


def duty(settings: GaitSettings, gait: Gait) -> Float[Array, ""]:
    """Fraction of the period that a foot stands."""
    return settings.duty + (settings.walk_duty - settings.duty) * gait.walk


def _unwrapped(gait: Gait, phase: jax.Array) -> jax.Array:
    """Phase of each leg, whole strides included. Shape (...) to (..., 4)."""
    return phase[..., None] + jnp.array(TROT_OFFSETS) + gait.walk * jnp.array(WALK_SHIFT)


def leg_phase(gait: Gait, phase: jax.Array) -> jax.Array:
    """Phase of each leg in [0, 1): it stands while below the duty, then swings. Shape (...) to (..., 4)."""
    return jnp.mod(_unwrapped(gait, phase), 1.0)


def scheduled(settings: GaitSettings, gait: Gait) -> Bool[Array, "4"]:
    """Which feet stand by the clock."""
    return leg_phase(gait, gait.phase) < duty(settings, gait)


def late(settings: GaitSettings, gait: Gait) -> Bool[Array, "4"]:
    """Which feet are still in the air and should stand by the clock."""
    return scheduled(settings, gait) & ~gait.landed


def late_by(settings: GaitSettings, gait: Gait) -> Float[Array, "4"]:
    """How long ago each foot that is late should have landed; else 0 [s]."""
    return jnp.where(late(settings, gait), leg_phase(gait, gait.phase) * gait.period, 0.0)


def swing_progress(settings: GaitSettings, gait: Gait) -> Float[Array, "4"]:
    """Progress of each swing in [0, 1]; 0 while the foot stands by the clock, and 1 while it is late."""
    stands = duty(settings, gait)
    progress = jnp.clip((leg_phase(gait, gait.phase) - stands) / (1 - stands), 0.0, 1.0)
    return jnp.where(late(settings, gait), 1.0, progress)


def time_to_touch_down(gait: Gait) -> Float[Array, "4"]:
    """Until each foot next lands by the clock [s]."""
    return (1.0 - leg_phase(gait, gait.phase)) * gait.period


def swing_duration(settings: GaitSettings, gait: Gait) -> Float[Array, ""]:
    """How long a foot swings [s]."""
    return gait.period * (1 - duty(settings, gait))


def stance_duration(settings: GaitSettings, gait: Gait) -> Float[Array, ""]:
    """How long a foot stands [s]."""
    return gait.period * duty(settings, gait)


def _phase_after(settings: GaitSettings, gait: Gait, elapsed: jax.Array) -> jax.Array:
    """The phase, not wrapped, after some time [s]: it stops at 0 or 1/2 when the robot is to stand."""
    after = gait.phase + elapsed / gait.period
    if settings.duty <= 0.5:  # there is no phase with all feet down
        return after
    pure = (gait.walk <= 0.0) | (gait.walk >= 1.0)
    return jnp.where(gait.stand & pure, jnp.minimum(after, jnp.ceil(2 * gait.phase) / 2), after)


def contacts_ahead(settings: GaitSettings, gait: Gait, elapsed: Float[Array, " N"]) -> Bool[Array, "N 4"]:
    """Which feet will stand after the given times [s]: by the clock, corrected by what they touch now."""
    by_clock = leg_phase(gait, _phase_after(settings, gait, elapsed)) < duty(settings, gait)
    early = gait.landed & ~scheduled(settings, gait) & (elapsed[:, None] < time_to_touch_down(gait))
    missing = (late_by(settings, gait) > GRACE) & (jnp.arange(len(elapsed)) == 0)[:, None]
    return (by_clock | early) & ~missing


def landings_ahead(settings: GaitSettings, gait: Gait, elapsed: Float[Array, " N"]) -> Int[Array, "N 4"]:
    """How often each foot will have landed by the clock after the given times [s]."""
    after = jnp.floor(_unwrapped(gait, _phase_after(settings, gait, elapsed)))
    return (after - jnp.floor(_unwrapped(gait, gait.phase))).astype(jnp.int32)


def advance(settings: GaitSettings, gait: Gait, dt: float, touching: Bool[Array, "4"] | None) -> Gait:
    """One control step on.

    Args:
        settings, gait: as they are.
        dt: [s].
        touching: which feet touch something. None: the robot cannot feel, and the clock is believed.
    """
    phase = jnp.mod(_phase_after(settings, gait, jnp.float32(dt)), 1.0)
    moved = gait._replace(phase=phase)
    by_clock = scheduled(settings, moved)
    if touching is None:
        return moved._replace(landed=by_clock)
    coming_down = swing_progress(settings, moved) > 0.5
    return moved._replace(landed=(gait.landed | touching) & (by_clock | coming_down))


def schedule(
    settings: GaitSettings,
    gait: Gait,
    speed: Float[Array, ""],
    longest_stride: Float[Array, ""],
    at_rest: Bool[Array, ""],
    dt: float,
) -> Gait:
    """Choose gait and period for the speed and the legs, once a plan.

    Args:
        settings, gait: as they are.
        speed: of the reference in the plane [m/s].
        longest_stride: that the legs allow at the height of the trunk [m].
        at_rest: nothing asks for a step.
        dt: since the last plan [s].
    """
    share = jnp.clip(speed / settings.full_speed, 0.0, 1.0)
    trot_period = settings.slow_period + (settings.period - settings.slow_period) * share
    within_reach = longest_stride / jnp.maximum(speed, 1e-3)
    trot_period = jnp.minimum(trot_period, jnp.maximum(within_reach, settings.shortest_period))
    wanted = jnp.float32(speed < settings.walk_speed)
    walk = jnp.clip(gait.walk + jnp.clip(wanted - gait.walk, -dt / BLEND_TIME, dt / BLEND_TIME), 0.0, 1.0)
    period = trot_period + (settings.walk_period - trot_period) * walk
    return gait._replace(walk=walk, period=period, stand=at_rest)


def step_height(
    settings: GaitSettings, speed: Float[Array, ""], headroom: Float[Array, ""], least: float
) -> Float[Array, ""]:
    """Lift of a swinging foot [m]: higher when fast, and at most its share of what the knee's limit leaves.

    Args:
        settings: of the gait.
        speed: of the body in the plane [m/s].
        headroom: lift at which the knee reaches its limit [m].
        least: lift that takes a foot off the floor at all [m].
    """
    share = jnp.clip(speed / settings.full_speed, 0.0, 1.0)
    lift = settings.slow_step_height + (settings.step_height - settings.slow_step_height) * share
    return jnp.clip(settings.headroom_fraction * headroom, least, lift)
