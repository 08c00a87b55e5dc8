"""Exact Euclidean projections onto the forces that a foot can have."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

ConeProjection = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]  # (forces, friction, force_max)


def project_cone(force: jax.Array, friction: jax.Array | float, force_max: jax.Array | float) -> jax.Array:
    """Nearest point of {|f_xy| <= mu f_z, 0 <= f_z <= f_max}.

    Where the projection onto the cone is above f_max, the nearest point of the truncated cone lies on its disc at
    f_max.

    Args:
        force: shape (N, 4, 3), or (N, 4, 3, batch).
        friction, force_max: shape (), or (batch,).
    """
    x, y, normal = force[:, :, 0], force[:, :, 1], force[:, :, 2]
    length = jnp.sqrt(x * x + y * y + 1e-20)
    on_cone = (normal + friction * length) / (1 + friction**2)
    inside = length <= friction * normal
    polar = friction * length <= -normal
    new_normal = jnp.where(inside, normal, jnp.where(polar, 0.0, on_cone))
    new_normal = jnp.clip(new_normal, 0.0, force_max)
    # Inside the cone the tangential part stays; otherwise it is cut to the cone's radius at the new height.
    cut = jnp.minimum(1.0, friction * new_normal / length)
    return jnp.stack([x * cut, y * cut, new_normal], 2)


def project_pyramid(force: jax.Array, friction: jax.Array | float, force_max: jax.Array | float) -> jax.Array:
    """Nearest point of {|f_x| <= mu f_z, |f_y| <= mu f_z, 0 <= f_z <= f_max}.

    At a normal force n the tangential forces are clipped to mu n, so what remains is convex in n alone: its derivative
    n - f_z - mu sum_i max(|f_i| - mu n, 0) is piecewise linear with the breakpoints |f_i| / mu.

    Args:
        force: shape (N, 4, 3), or (N, 4, 3, batch).
        friction, force_max: shape (), or (batch,).
    """
    x, y, normal = force[:, :, 0], force[:, :, 1], force[:, :, 2]
    small, large = jnp.minimum(jnp.abs(x), jnp.abs(y)), jnp.maximum(jnp.abs(x), jnp.abs(y))
    both_cut = (normal + friction * (small + large)) / (1 + 2 * friction**2)
    one_cut = (normal + friction * large) / (1 + friction**2)
    new_normal = jnp.where(
        friction * both_cut <= small, both_cut, jnp.where(friction * one_cut <= large, one_cut, normal)
    )
    new_normal = jnp.clip(new_normal, 0.0, force_max)
    bound = friction * new_normal
    return jnp.stack([jnp.clip(x, -bound, bound), jnp.clip(y, -bound, bound), new_normal], 2)


PROJECTIONS: dict[str, ConeProjection] = {"cone": project_cone, "pyramid": project_pyramid}


def shrink_into(force: jax.Array, image: jax.Array, lower: jax.Array, upper: jax.Array) -> jax.Array:
    """Scale a force towards zero until lower <= its linear image <= upper; it leaves no cone on the way.

    Args:
        force: shape (..., 3).
        image: of the force, shape (..., 3).
        lower, upper: bounds that contain zero, shape (..., 3).
    """
    bound = jnp.where(image > 0, upper, lower)
    inside = jnp.abs(image) <= jnp.abs(bound)
    return force * jnp.where(inside, 1.0, bound / jnp.where(inside, 1.0, image)).min(-1)[..., None]
