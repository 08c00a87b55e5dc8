import json

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from pydantic import ValidationError
from synthetic import BRIEF, LIMITS, SMALL, fit, smooth_samples, table_scene, train_small

from agile_jax.policy import PolicySettings, make_policy
from agile_jax.settings import BadInput
from agile_jax.training import Samples, TrainingSettings
from agile_jax.training.checkpoint import load_parameters
from agile_jax.training.epochs import TrainState, encode_samples, make_step, mean_squared_error


def same(a, b):
    leaves = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(x, y) for x, y in leaves)


def numpy_step(network, features, base, gain, scale, labels, rate, bounded):
    """One step of gradient descent on the mean squared error, by hand, in float64. Returns loss and parameters."""
    layers = [
        (np.asarray(p["kernel"], np.float64), np.asarray(p["bias"], np.float64))
        for _, p in sorted(network["params"].items())
    ]
    inputs, x = [], features
    for i, (kernel, bias) in enumerate(layers):
        inputs.append(x)
        x = x @ kernel + bias
        if i + 1 < len(layers):
            x = np.tanh(x)
    output = 2 * np.tanh(x / 2) if bounded else x
    error = base + gain * scale * output - labels
    loss = (error**2).mean()
    delta = 2 * error * gain * scale / error.size * ((1 - (output / 2) ** 2) if bounded else 1)
    updated = []
    for i in reversed(range(len(layers))):
        kernel, bias = layers[i]
        updated.insert(0, (kernel - rate * inputs[i].T @ delta, bias - rate * delta.sum(0)))
        delta = (delta @ kernel.T) * (1 - inputs[i] ** 2)  # of the activation before; unused for the first layer
    return loss, updated


@pytest.mark.parametrize("kind", ["plain", "residual"])
def test_one_sgd_step_equals_backpropagation_by_hand(kind):
    policy = make_policy(table_scene(), LIMITS, PolicySettings(kind=kind, hidden_layers=(7, 5)))
    poses, velocities = smooth_samples(32)
    samples = encode_samples(policy, Samples(poses, velocities))
    parameters = policy.normalise(
        policy.init(jax.random.key(0), "torch_uniform"), np.asarray(samples.encoding.features)
    )
    optimizer = optax.sgd(0.5)
    state = TrainState(parameters, optimizer.init(parameters.network), jnp.int32(0))
    state, loss = jax.jit(make_step(policy, optimizer))(state, samples)

    mean, std, scale = (np.asarray(x, np.float64) for x in parameters.normalization)
    features, base, gain = (np.asarray(x, np.float64) for x in samples.encoding)
    expected_loss, expected = numpy_step(
        parameters.network,
        (features - mean) / std,
        base,
        gain,
        scale,
        velocities.astype(np.float32),
        0.5,
        kind == "residual",
    )
    assert float(loss) == pytest.approx(expected_loss, rel=1e-5)
    for i, (kernel, bias) in enumerate(expected):
        layer = state.parameters.network["params"][f"Dense_{i}"]
        np.testing.assert_allclose(layer["kernel"], kernel, atol=2e-6)
        np.testing.assert_allclose(layer["bias"], bias, atol=2e-6)
    assert same(state.parameters.normalization, parameters.normalization)


def test_mean_squared_error_over_blocks_equals_the_mean(monkeypatch):
    monkeypatch.setattr("agile_jax.training.epochs.BLOCK", 64)
    policy = make_policy(table_scene(), LIMITS, SMALL)
    poses, velocities = smooth_samples(150)
    samples = encode_samples(policy, Samples(poses, velocities))
    parameters = policy.init(jax.random.key(0))
    predicted = jax.vmap(policy.output, (None, 0))(parameters, samples.encoding)
    expected = np.mean((np.asarray(predicted) - velocities) ** 2)
    assert float(mean_squared_error(policy, parameters, samples)) == pytest.approx(expected, rel=1e-5)


def test_training_learns_and_writes_one_row_an_epoch(uninterrupted):
    rows = [json.loads(line) for line in (uninterrupted / "metrics.jsonl").read_text().splitlines()]
    assert [row["epoch"] for row in rows] == list(range(1, 9))
    assert [row["step"] for row in rows] == [8 * epoch for epoch in range(1, 9)]  # ceil(500 / 64) steps an epoch
    assert rows[-1]["validation_mse"] < 0.6 * rows[0]["validation_mse"]
    assert rows[0]["learning_rate"] > 10 * rows[-1]["learning_rate"]
    assert list((uninterrupted / "tensorboard").glob("events*"))


def test_training_twice_gives_the_same_bits_and_another_seed_others(uninterrupted, tmp_path):
    policy, fitted = train_small(tmp_path)
    assert same(fitted.parameters, load_parameters(uninterrupted, policy))
    assert (tmp_path / "metrics.jsonl").read_bytes() == (uninterrupted / "metrics.jsonl").read_bytes()
    labels = smooth_samples(500), smooth_samples(100, 1)
    brief = BRIEF.model_copy(update={"epochs": 1})
    other = [fit(policy, *labels, brief, seed, tmp_path / str(seed)) for seed in (1, 2)]
    assert not same(other[0].parameters, other[1].parameters)


def test_in_memory_gives_the_same_bits(uninterrupted):
    policy = make_policy(table_scene(), LIMITS, SMALL)
    fitted = fit(policy, smooth_samples(500), smooth_samples(100, 1), BRIEF, 3)
    assert same(fitted.parameters, load_parameters(uninterrupted, policy))
    assert fitted.rows == [json.loads(line) for line in (uninterrupted / "metrics.jsonl").read_text().splitlines()]


def test_finished_training_trains_no_more(uninterrupted):
    before = (uninterrupted / "metrics.jsonl").read_bytes()
    calls = []
    train_small(uninterrupted, lambda work, done, total, note="": calls.append(done))
    assert calls == [8]  # it only said where it stands
    assert (uninterrupted / "metrics.jsonl").read_bytes() == before


def test_divergence_names_the_step_and_a_remedy(tmp_path):
    settings = TrainingSettings(optimizer="sgd", schedule="constant", learning_rate=1e6, batch_size=64, epochs=3)
    policy = make_policy(table_scene(), LIMITS, SMALL.model_copy(update={"kind": "plain"}))
    labels = smooth_samples(500), smooth_samples(100, 1)
    with pytest.raises(BadInput, match=r"diverged.*step \d+.*lower training.learning_rate"):
        fit(policy, *labels, settings, 0, tmp_path)
    assert not list(tmp_path.glob("checkpoints/*"))


def test_unusable_samples_are_refused(tmp_path):
    policy = make_policy(table_scene(), LIMITS, SMALL)
    poses, velocities = smooth_samples(100)
    bad = velocities.copy()
    bad[17, 2] = np.nan
    with pytest.raises(BadInput, match="an output that is not finite, first in sample 17"):
        fit(policy, Samples(poses, bad), Samples(poses, velocities), BRIEF, 0, tmp_path)
    with pytest.raises(BadInput, match=r"batch_size = 64 is larger than the 10 training samples"):
        fit(policy, Samples(poses[:10], velocities[:10]), Samples(poses, velocities), BRIEF, 0, tmp_path)
    with pytest.raises(BadInput, match="validation split is empty"):
        fit(policy, Samples(poses, velocities), Samples(poses[:0], velocities[:0]), BRIEF, 0, tmp_path)
    assert not list(tmp_path.iterdir())


def test_inputs_without_spread_do_not_explode():
    policy = make_policy(table_scene(), LIMITS, SMALL)
    poses = smooth_samples(100)[0]
    poses[:, 3] = 1e-9 * np.arange(100)  # the paper's starts have no spread in yaw
    features = np.asarray(encode_samples(policy, Samples(poses, poses)).encoding.features)
    normalization = policy.normalise(policy.init(jax.random.key(0)), features).normalization
    assert float(normalization.std[3]) == pytest.approx(3.2)
    np.testing.assert_allclose(normalization.std[0], poses[:, 0].std(), rtol=1e-4)


def test_torch_uniform_is_uniform_within_one_over_the_root_of_the_inputs():
    policy = make_policy(table_scene(), LIMITS, PolicySettings(hidden_layers=(100, 400)))
    layer = jax.jit(lambda key: policy.init(key, "torch_uniform"))(jax.random.key(0)).network["params"]["Dense_1"]
    for leaf in layer.values():
        assert float(jnp.abs(leaf).max()) == pytest.approx(0.1, rel=0.02)
        assert float(leaf.std()) == pytest.approx(0.1 / np.sqrt(3), rel=0.1)


def test_settings_refuse_contradictions():
    with pytest.raises(ValidationError, match="weight_decay"):
        TrainingSettings(optimizer="adam", weight_decay=0.1)
    with pytest.raises(ValidationError):
        PolicySettings(hidden_layers=())
    with pytest.raises(ValidationError):
        TrainingSettings(keep=1)
