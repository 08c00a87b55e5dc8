"""In which precision the wide layers of a network are multiplied during training.

    float32        operands as they are
    tensorfloat32  operands rounded to 10 bits of mantissa, as a GPU's tensor cores read them
    bfloat16       operands rounded to 7 bits of mantissa

Products are summed in float32 in all three, and so are parameters, activations, biases, the loss and the optimiser.
The rounding is written out, so that every platform computes the same: by itself a CPU ignores the precision that is
asked of a product, and a GPU takes float32 for tensorfloat32. Layers with fewer than 32 inputs or outputs, thus the
first and the last, stay float32: they carry units, and cost nothing.

How the gradient of the weights is multiplied, x^T g, decides the speed on a CPU. XLA folds the transposition into the
product, and has no fast kernel for that (nor any for bfloat16: it goes back to float32). Transposed in two halves,
x is no longer a mere transpose to XLA, so it is laid out anew and goes to the fast kernels. On processors
with bfloat16 instructions or matrix tiles, these are what makes bfloat16 pay. A GPU reads transposed operands as fast.

All this is about one compiler. `agile benchmark training` measures the same steps with the layers' own products: when
its metric `ours_float32.over_plain` is near 1, XLA has become as fast, and this module can shrink to the rounding.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Precision = Literal["float32", "tensorfloat32", "bfloat16"]
Product = Callable[[jax.Array, jax.Array], jax.Array]

NARROW = 32  # layers with fewer inputs or outputs stay float32


@contextmanager
def products(precision: Precision | None) -> Iterator[None]:
    """Trace networks inside so that their wide layers multiply in this precision, forwards and backwards.

    None leaves the products to the layers, in float32: what a benchmark compares with.
    """
    if precision is None:
        with jax.default_matmul_precision("float32"):
            yield
        return
    product = make_product(precision)

    def dense(
        layer: Callable[..., jax.Array],
        inputs: tuple[jax.Array, ...],
        keywords: dict[str, object],
        context: nn.module.InterceptorContext,
    ) -> jax.Array:
        module = context.module
        if context.method_name != "__call__" or not isinstance(module, nn.Dense):
            return layer(*inputs, **keywords)
        kernel = module.get_variable("params", "kernel")
        if min(kernel.shape) < NARROW:
            return layer(*inputs, **keywords)
        return product(inputs[0], kernel) + module.get_variable("params", "bias")

    with jax.default_matmul_precision("float32"), nn.intercept_methods(dense):
        yield


@cache
def make_product(precision: Precision) -> Product:
    """x @ w for x (..., f) and w (f, o), with its gradient. To be differentiated under vmap over x."""

    @jax.custom_vjp
    def product(x: jax.Array, w: jax.Array) -> jax.Array:
        return _dot(rounded(x, precision), rounded(w, precision), precision)

    def forward(x: jax.Array, w: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        x, w = rounded(x, precision), rounded(w, precision)
        return _dot(x, w, precision), (x, w)

    def backward(operands: tuple[jax.Array, jax.Array], g: jax.Array) -> tuple[jax.Array, jax.Array]:
        x, w = operands
        g = rounded(g, precision)
        rows = x.reshape(-1, x.shape[-1]), g.reshape(-1, g.shape[-1])
        dw = jax.lax.platform_dependent(*rows, cpu=in_halves, default=lambda x, g: _dot(x.T, g, precision))
        return _dot(g, w.T, precision), dw

    def in_halves(x: jax.Array, g: jax.Array) -> jax.Array:
        halves = 2 if len(x) % 2 == 0 else 1
        transposed = x.reshape(halves, -1, x.shape[-1]).transpose(2, 0, 1).reshape(x.shape[::-1])
        return _dot(transposed, g, precision)

    product.defvjp(forward, backward)

    # Left to itself, vmap would make one outer product a sample out of the gradient of w.
    @jax.custom_batching.custom_vmap
    def batched(x: jax.Array, w: jax.Array) -> jax.Array:
        return product(x, w)

    @batched.def_vmap
    def whole_batch(size: int, axes: list[bool], x: jax.Array, w: jax.Array) -> tuple[jax.Array, bool]:
        del size
        if axes[1]:
            return jax.vmap(product, (0 if axes[0] else None, 0))(x, w), True
        return product(x, w), True

    return batched


def rounded(x: Float[Array, "*shape"], precision: Precision) -> Float[Array, "*shape"]:
    """An operand of a product in this precision."""
    if precision == "bfloat16":
        return x.astype(jnp.bfloat16)
    return jax.lax.reduce_precision(x, 8, 10) if precision == "tensorfloat32" else x


def _dot(x: jax.Array, w: jax.Array, precision: Precision) -> jax.Array:
    """x @ w summed in float32. A GPU's default reads float32 operands as tensorfloat32: exact for rounded ones."""
    asked = jax.lax.Precision.HIGHEST if precision == "float32" else jax.lax.Precision.DEFAULT
    return jnp.matmul(x, w, precision=asked, preferred_element_type=jnp.float32)
