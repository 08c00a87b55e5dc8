"""The array type of functions that work on NumPy and on JAX arrays alike, for jaxtyping's annotations.

`Float[AnyArray, "n 4"]` asks for floats of two axes from either library. This module loads neither, so that
the packages without JAX can use it.
"""

from typing import Any, TypeAlias

AnyArray: TypeAlias = Any  # whatever has a shape and a dtype
