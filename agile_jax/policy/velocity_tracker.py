"""Follow a velocity field with bounded acceleration, without leaving its path."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray


def track(
    wanted: Float[AnyArray, "4"],
    velocity: Float[AnyArray, "4"],
    acceleration_limit: Float[AnyArray, "4"],
    dt: float | Float[AnyArray, ""],
) -> Float[Array, "4"]:
    """The velocity [m/s, rad/s] after one step towards `wanted`, within the acceleration limits of every axis.

    The field's direction is its path around obstacles. So while some axis cannot reach its part of `wanted` yet (from
    rest, none can), the whole of `wanted` is scaled down, as far as the slowest axis needs, rather than bent; each axis
    then changes towards its scaled part as fast as it may.

    Args:
        wanted: the policy's velocity [m/s, rad/s].
        velocity: the current one [m/s, rad/s].
        acceleration_limit: of every axis [m/s^2, rad/s^2].
        dt: length of the step [s].
    """
    reach = acceleration_limit * dt
    # The largest scale with scale * wanted within reach ahead of the current velocity, in the direction of `wanted`.
    ahead = velocity * jnp.sign(wanted) + reach
    scale = jnp.min(jnp.where(jnp.abs(wanted) > 1e-6, ahead / jnp.maximum(jnp.abs(wanted), 1e-6), 1.0))
    scale = jnp.clip(scale, 0.0, 1.0)
    return velocity + jnp.clip(scale * wanted - velocity, -reach, reach)
