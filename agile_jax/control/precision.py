"""Single precision whatever JAX's flags are: with `JAX_ENABLE_X64` a control step is the same, bit for bit."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def in_float32(function: Callable[P, R]) -> Callable[P, R]:
    """The function computed in float32 and int32, also inside another function that JAX compiles with 64 bits.

    Arrays in float64 among its arguments are rounded first; objects that are no pytrees are passed as they are.
    """

    @functools.wraps(function)
    def rounded(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(False):
            return function(*as_float32(args), **as_float32(kwargs))

    return rounded


def as_float32(values: T) -> T:
    """A pytree with its float64 arrays rounded."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32) if _is_double(leaf) else leaf, values)


def _is_double(leaf: object) -> bool:
    return getattr(leaf, "dtype", None) == np.float64
