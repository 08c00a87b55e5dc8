"""Policy and training compute in float32, whatever JAX's flag for 64 bits says.

The flag changes what JAX makes of Python's numbers and of integers divided, also inside Optax and Flax. So the entries
from outside run with it off, and arrays are made with their type written out.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
import numpy as np

from agile_jax.scene import Scene

P = ParamSpec("P")
R = TypeVar("R")


def float32_scene(scene: Scene) -> Scene:
    """The scene with all lengths and angles in float32."""
    single = {name: np.asarray(array, np.float32) for name, array in scene._asdict().items() if array.dtype.kind == "f"}
    return scene._replace(**single)


def in_single_precision(function: Callable[P, R]) -> Callable[P, R]:
    """The function with JAX's 64 bits switched off while it runs."""

    @functools.wraps(function)
    def single(*arguments: P.args, **keywords: P.kwargs) -> R:
        with jax.enable_x64(False):
            return function(*arguments, **keywords)

    return single
