"""The products of the wide layers: their gradients, what they round, and what they leave alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from synthetic import LIMITS, smooth_samples, table_scene

from agile_jax.policy import PolicySettings, make_policy
from agile_jax.training.epochs import encode_samples, squared_errors
from agile_jax.training.precision import make_product, products, rounded

UNIT_ROUNDOFF = {"float32": 2.0**-24, "tensorfloat32": 2.0**-11, "bfloat16": 2.0**-8}
NETWORK = PolicySettings(kind="plain", hidden_layers=(64, 96, 64))


@pytest.fixture(scope="module")
def problem():
    policy = make_policy(table_scene(), LIMITS, NETWORK)
    samples = encode_samples(policy, smooth_samples(128))
    return policy, policy.init(jax.random.key(0), "torch_uniform"), samples


def gradient_in(precision, problem):
    policy, parameters, samples = problem

    def loss(network):
        return squared_errors(policy, parameters._replace(network=network), samples).mean()

    if precision is None:
        return jax.jit(jax.grad(loss))(parameters.network)["params"]
    with products(precision):
        return jax.jit(jax.grad(loss))(parameters.network)["params"]


@pytest.mark.parametrize("precision", UNIT_ROUNDOFF)
def test_gradient_is_that_of_float32_within_the_rounding_of_the_operands(precision, problem):
    """Two operands a product and three products on the way to the first layer, forwards and back: some 12 roundings,
    of which the largest error is allowed and the typical one is a tenth."""
    exact, ours = gradient_in(None, problem), gradient_in(precision, problem)
    for layer in exact:
        for name in ("kernel", "bias"):
            a, b = np.asarray(exact[layer][name]), np.asarray(ours[layer][name])
            assert b.dtype == np.float32
            error = np.linalg.norm(a - b) / np.linalg.norm(a)
            assert error < 12 * UNIT_ROUNDOFF[precision], (layer, name)
    middle = np.asarray(exact["Dense_1"]["kernel"]) - np.asarray(ours["Dense_1"]["kernel"])
    if precision != "float32":  # it is not float32 under another name
        assert np.linalg.norm(middle) / np.linalg.norm(exact["Dense_1"]["kernel"]) > 0.05 * UNIT_ROUNDOFF[precision]


@pytest.mark.parametrize("rows", [32, 33])
def test_bfloat16_product_and_gradient_equal_those_of_rounded_operands_in_float64(rows):
    generator = np.random.default_rng(0)
    x, w, g = (jnp.float32(generator.normal(size=size)) for size in ((rows, 40), (40, 50), (rows, 50)))
    product = make_product("bfloat16")
    y, back = jax.vjp(lambda x, w: jax.vmap(product, (0, None))(x, w), x, w)
    dx, dw = back(g)
    x, w, g = (np.asarray(a.astype(jnp.bfloat16), np.float64) for a in (x, w, g))
    for ours, exact in ((y, x @ w), (dx, g @ w.T), (dw, x.T @ g)):
        np.testing.assert_allclose(ours, exact, atol=1e-4)  # exact products, summed in float32


def test_tensorfloat32_keeps_ten_bits():
    x = jnp.float32(1 + np.array([2.0**-10, 2.0**-11 * 0.9, 2.0**-11 * 1.1]))
    np.testing.assert_array_equal(rounded(x, "tensorfloat32"), 1 + np.array([2.0**-10, 0, 2.0**-10]))


def test_seeds_batch_the_products():
    generator = np.random.default_rng(1)
    x, w = generator.normal(size=(3, 8, 40)), generator.normal(size=(3, 40, 50))
    product = make_product("float32")
    batched = jax.vmap(jax.grad(lambda w, x: (jax.vmap(product, (0, None))(x, w) ** 2).sum()))
    exact = np.einsum("sbf,sbo->sfo", x, 2 * x @ w)
    np.testing.assert_allclose(batched(jnp.float32(w), jnp.float32(x)), exact, rtol=1e-4, atol=1e-3)


def test_no_intermediate_holds_a_weight_matrix_for_every_sample(problem):
    """vmap over samples of a gradient with its own rule would make one."""
    policy, parameters, samples = problem

    def loss(network):
        return squared_errors(policy, parameters._replace(network=network), samples).mean()

    with products("bfloat16"):
        text = str(jax.make_jaxpr(jax.grad(loss))(parameters.network))
    assert "[128,96]" in text
    assert "[128,64,96]" not in text
