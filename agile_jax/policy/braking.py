"""The closed-form field that drives straight to the target and brakes in time.

Per axis i with error e_i, speed bound V_i and acceleration bound A_i, the fastest speed from which the axis can
still stop at its target is sqrt(2 A_i |e_i|). Its slope is infinite at the target, where a sampled controller would
chatter, so the last A_i / k^2 are linear with rate k, joined with equal value and slope:

    b_i(e) = min(V_i, k |e|)                           |e| <= A_i / k^2
             min(V_i, sqrt(2 A_i (|e| - A_i / (2 k^2))))   beyond

Deceleration never exceeds A_i: k^2 |e| <= A_i in the linear part. The field -e min_i b_i(e_i) / |e_i| keeps the
direction of the target, and every axis within its own bounds. It is continuous, and -k e around the target.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.expert import MotionLimits

TINY = 1e-9  # [m] or [rad], below which an error is zero


class Braking(NamedTuple):
    """The braking law at one pose."""

    velocity: Float[Array, "4"]  # [m/s, rad/s]
    fraction: Float[Array, ""]  # fastest axis over its bound, 0 at the target, 1 in full motion [-]
    time_to_go: Float[Array, ""]  # rest-to-rest time of the slowest axis [s]


def braking_rate(
    distance: Float[Array, "*shape"],
    velocity_limit: Float[AnyArray, "*shape"],
    acceleration_limit: Float[AnyArray, "*shape"],
    approach_rate: float,
) -> Float[Array, "*shape"]:
    """b(e) / |e| [1/s] for distances |e| >= 0 [m, rad] and the bounds of their rates; k = `approach_rate` [1/s]."""
    linear = acceleration_limit / approach_rate**2
    safe = jnp.maximum(distance, linear)
    root = jnp.sqrt(2.0 * acceleration_limit * (safe - linear / 2)) / safe
    rate = jnp.where(distance < linear, approach_rate, root)
    return jnp.minimum(rate, velocity_limit / jnp.maximum(distance, TINY))


def rest_to_rest_time(
    distance: Float[Array, "*shape"],
    velocity_limit: Float[AnyArray, "*shape"],
    acceleration_limit: Float[AnyArray, "*shape"],
) -> Float[Array, "*shape"]:
    """Minimum time [s] of one axis over a distance >= 0 [m, rad] between two rests, elementwise."""
    reaches_limit = distance > velocity_limit**2 / acceleration_limit
    # Square root of a safe number: the derivative stays finite at the target.
    triangle = 2.0 * jnp.sqrt(jnp.maximum(distance, TINY) / acceleration_limit)
    return jnp.where(reaches_limit, distance / velocity_limit + velocity_limit / acceleration_limit, triangle)


def braking_law(error: Float[Array, "4"], limits: MotionLimits, approach_rate: float) -> Braking:
    """The straight-line braking law towards zero error.

    Args:
        error: pose minus target [m, rad].
        limits: bounds of velocity and acceleration.
        approach_rate: k [1/s].
    """
    velocity_limit, acceleration_limit = (jnp.asarray(limit, error.dtype) for limit in limits)
    distance = jnp.abs(error)
    rate = braking_rate(distance, velocity_limit, acceleration_limit, approach_rate).min()
    return Braking(
        velocity=-error * rate,
        fraction=(rate * distance / velocity_limit).max(),
        time_to_go=rest_to_rest_time(distance, velocity_limit, acceleration_limit).max(),
    )


def network_gain(law: Braking, blend_time: float) -> Float[Array, ""]:
    """How much of a network's output joins the law [-]: 0 at the target, 1 in full motion (field.py).

    Args:
        law: at the pose.
        blend_time: time to go below which the network fades out [s].
    """
    return law.fraction * -jnp.expm1(-((law.time_to_go / blend_time) ** 2))
