"""Optimisers and schedules by name."""

from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

from agile_jax.experiment import Experiment, with_overrides
from agile_jax.settings import BadInput
from agile_jax.training import TrainingSettings
from agile_jax.training.optimizer import SCHEDULES, make_optimizer, make_schedule
from agile_jax.training.settings import WITH_MOMENTUM, WITH_WEIGHT_DECAY, Optimizer, Schedule

# Their steps are not in proportion to the gradient, or begin tiny, so a rate that suits one does not suit all.
RATES = {"adadelta": 30.0, "lamb": 0.05, "lars": 30.0, "sgd": 0.3, "adagrad": 0.3, "novograd": 0.3}


def minimise(settings, steps=150):
    """Loss over its first value on a linear regression."""
    generator = np.random.default_rng(0)
    x = jnp.asarray(generator.normal(size=(64, 5)), jnp.float32)
    y = x @ jnp.asarray(generator.normal(size=(5, 3)), jnp.float32)
    optimizer = make_optimizer(settings, steps)
    w = jnp.full((5, 3), 0.1)

    def loss(w):
        return ((x @ w - y) ** 2).mean()

    def step(carry, _):
        w, state = carry
        value, gradient = jax.value_and_grad(loss)(w)
        updates, state = optimizer.update(gradient, state, w)
        return (w + updates, state), value

    (w, _), values = jax.jit(lambda carry: jax.lax.scan(step, carry, length=steps))((w, optimizer.init(w)))
    return float(loss(w) / values[0]), w


@pytest.mark.parametrize("name", get_args(Optimizer))
def test_every_optimiser_minimises(name):
    ratio, _ = minimise(TrainingSettings(optimizer=name, learning_rate=RATES.get(name, 0.1)))
    assert ratio < 0.2


def test_the_names_are_those_of_the_tables():
    assert set(get_args(Schedule)) == set(SCHEDULES)


@pytest.mark.parametrize("name", WITH_WEIGHT_DECAY)
def test_weight_decay_alone_shrinks_the_weights(name):
    w = jnp.array([1.0, -2.0, 3.0])
    for decay in (0.0, 0.1):
        optimizer = make_optimizer(TrainingSettings(optimizer=name, weight_decay=decay), 10)
        updates, _ = optimizer.update(jnp.zeros(3), optimizer.init(w), w)
        assert (updates * w <= 0).all()
        assert bool(jnp.any(updates != 0)) == (decay > 0)


@pytest.mark.parametrize("name", WITH_MOMENTUM)
def test_momentum_and_nesterov_change_the_steps(name):
    def weights(**options):
        return minimise(TrainingSettings(optimizer=name, learning_rate=RATES.get(name, 0.01), **options), 10)[1]

    assert not np.allclose(weights(momentum=0.9), weights(), rtol=1e-3)
    assert not np.allclose(weights(momentum=0.9), weights(momentum=0.9, nesterov=True), rtol=1e-3)


def test_sgd_with_momentum_by_hand():
    optimizer = make_optimizer(
        TrainingSettings(optimizer="sgd", learning_rate=0.5, momentum=0.9, schedule="constant", clip_norm=1.0), 10
    )
    state, w, velocity = optimizer.init(jnp.zeros(2)), np.zeros(2), np.zeros(2)
    for gradient in (np.array([3.0, 4.0]), np.array([0.3, 0.4])):  # of norm 5, clipped to 1; of norm 0.5, as it is
        updates, state = optimizer.update(jnp.asarray(gradient), state, jnp.asarray(w))
        velocity = 0.9 * velocity + gradient / max(1, np.linalg.norm(gradient))
        np.testing.assert_allclose(updates, -0.5 * velocity, rtol=1e-6)


@pytest.mark.parametrize("name", ["linear", "cosine", "exponential", "polynomial"])
def test_schedules_fall_from_the_rate_to_the_final_share(name):
    schedule = make_schedule(TrainingSettings(schedule=name, learning_rate=0.5, final_rate=0.1), 100)
    rates = np.array([schedule(step) for step in range(101)])
    assert rates[0] == pytest.approx(0.5)
    assert rates[100] == pytest.approx(0.05)
    assert (np.diff(rates) <= 0).all()


def test_halfway_values_of_the_schedules():
    expected = {"linear": 0.275, "cosine": 0.275, "exponential": 0.5 * 0.1**0.5, "polynomial": 0.05 + 0.45 / 4}
    for name, rate in expected.items():
        settings = TrainingSettings(schedule=name, learning_rate=0.5, final_rate=0.1)
        assert float(make_schedule(settings, 100)(50)) == pytest.approx(rate), name
    for name in ("linear_onecycle", "cosine_onecycle"):
        rates = [float(make_schedule(TrainingSettings(schedule=name, learning_rate=0.5), 100)(i)) for i in range(101)]
        assert max(rates) == pytest.approx(0.5, rel=1e-3)
        assert rates[0] == pytest.approx(0.02)
        assert rates[100] < 1e-4


def test_warm_up_rises_from_zero_and_the_schedule_fills_the_rest():
    settings = TrainingSettings(schedule="linear", learning_rate=0.5, final_rate=0.1, warmup=0.2)
    rates = [float(make_schedule(settings, 100)(step)) for step in (0, 10, 20, 60, 100)]
    assert rates == pytest.approx([0, 0.25, 0.5, 0.275, 0.05])


def test_an_unknown_name_lists_the_known_ones():
    before = Experiment(name="n")
    with pytest.raises(BadInput, match=r"training\.optimizer.*'adabelief'.*'sgd'.*'yogi'"):
        with_overrides(before, {"training.optimizer": "lbfgs"}, "test")
    with pytest.raises(BadInput, match=r"training\.schedule.*'constant'.*'polynomial'"):
        with_overrides(before, {"training.schedule": "steps"}, "test")


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"optimizer": "adam", "weight_decay": 0.1}, 'weight_decay = 0.1 has no effect with optimizer = "adam".*adamw'),
        ({"optimizer": "adam", "momentum": 0.9}, "momentum = 0.9 has no effect.*sgd"),
        ({"optimizer": "sgd", "nesterov": True}, "nesterov = true has no effect without momentum"),
        ({"patience": 3}, 'needs select = "best"'),
        ({"batch_size": 10, "devices": 4}, "multiple of devices = 4"),
        ({"keep": 1}, "greater than or equal to 2"),
    ],
)
def test_contradictions_are_refused(values, match):
    with pytest.raises(ValidationError, match=match):
        TrainingSettings(**values)
