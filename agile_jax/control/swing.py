"""Swing legs: the path of a foot to its foothold."""

import jax
import jax.numpy as jnp


def swing_path(
    lift_off: jax.Array, touch_down: jax.Array, height: jax.Array, progress: jax.Array, duration: jax.Array | float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Position and velocity on the way from `lift_off` to `touch_down`.

    A cubic smooth step in the plane, and for the height two of them, up and down: velocity is zero at both ends
    and at the top.

    Args:
        lift_off, touch_down: shape (..., 3) [m].
        height: of the apex above the higher end, shape (...) [m].
        progress: in [0, 1], shape (...).
        duration: of the whole swing [s].

    Returns:
        Position [m], velocity [m/s] and acceleration [m/s^2], shape (..., 3) each.
    """

    def smooth(s: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return s * s * (3 - 2 * s), 6 * s * (1 - s), 6 - 12 * s

    way = (touch_down - lift_off)[..., :2]
    planar = [way * share[..., None] for share in smooth(progress)]
    planar[0] += lift_off[..., :2]
    apex = jnp.maximum(lift_off[..., 2], touch_down[..., 2]) + height
    rising = progress < 0.5
    rise = smooth(jnp.clip(2 * progress, 0.0, 1.0))
    fall = smooth(jnp.clip(2 * progress - 1, 0.0, 1.0))
    climb, drop = apex - lift_off[..., 2], touch_down[..., 2] - apex
    z = [jnp.where(rising, lift_off[..., 2] + climb * rise[0], apex + drop * fall[0])]
    z += [2**k * jnp.where(rising, climb * rise[k], drop * fall[k]) for k in (1, 2)]
    position, velocity, acceleration = (
        jnp.concatenate([planar[k], z[k][..., None]], -1) / duration**k for k in range(3)
    )
    return position, velocity, acceleration
