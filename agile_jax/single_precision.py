"""Single precision whatever JAX's flag for 64 bits says: results are the same, bit for bit, with and without it.

The flag changes what JAX makes of Python's numbers and of integers divided, also inside Optax and Flax. So what is
entered from outside runs with it off, and arrays are made with their type written out. This is the one module at the
top of the package that loads JAX.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def in_single_precision(function: Callable[P, R]) -> Callable[P, R]:
    """The function with JAX's 64 bits switched off while it runs; its arguments are passed as they are."""

    @functools.wraps(function)
    def single(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(False):
            return function(*args, **kwargs)

    return single


def in_float32(function: Callable[P, R]) -> Callable[P, R]:
    """The function computed in float32 and int32, also inside another function that JAX compiles with 64 bits.

    Arrays in float64 among its arguments are rounded first; objects that are no pytrees are passed as they are.
    """

    @functools.wraps(function)
    @in_single_precision
    def rounded(*args: P.args, **kwargs: P.kwargs) -> R:
        return function(*as_float32(args), **as_float32(kwargs))

    return rounded


def as_float32(values: T) -> T:
    """A pytree with its float64 arrays rounded."""

    def rounded(leaf: object) -> object:
        return jnp.asarray(leaf, jnp.float32) if getattr(leaf, "dtype", None) == np.float64 else leaf

    return jax.tree.map(rounded, values)
