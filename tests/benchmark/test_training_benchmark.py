"""The benchmark of the training: the same work for both frameworks, counted right, and the file that it writes."""

import itertools
import json
from importlib.util import find_spec

import numpy as np
import pytest

from agile_jax.benchmark.subjects import LARGE_NETWORK
from agile_jax.benchmark.training import METHODS, _torch, benchmark_training, report
from agile_jax.benchmark.workloads.throughput import make_products, make_workload, step_flops
from agile_jax.cli import main
from agile_jax.experiment import load_experiment
from agile_jax.policy import PolicySettings
from agile_jax.training import TrainingSettings

SMALL = PolicySettings(hidden_layers=(64, 96))
RATE = TrainingSettings(batch_size=128, learning_rate=0.5, initialisation="torch_uniform")

needs_torch = pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")


@pytest.fixture(scope="module")
def workload():
    return make_workload(SMALL, RATE, 6)


def test_the_work_is_what_a_step_by_hand_does(workload):
    """Gradient descent on the mean squared error, in float64."""
    work, compiled = workload
    parameters = [(k.astype(float), b.astype(float)) for k, b in zip(work.kernels, work.biases, strict=True)]
    losses = []
    for row in work.rows:
        inputs, x = [], work.poses[row].astype(float)
        for i, (kernel, bias) in enumerate(parameters):
            inputs.append(x)
            x = x @ kernel + bias
            x = np.tanh(x) if i + 1 < len(parameters) else x
        error = x - work.labels[row]
        losses.append((error**2).mean())
        delta = 2 * error / error.size
        for i in reversed(range(len(parameters))):
            kernel, bias = parameters[i]
            parameters[i] = kernel - 0.5 * inputs[i].T @ delta, bias - 0.5 * delta.sum(0)
            delta = (delta @ kernel.T) * (1 - inputs[i] ** 2)
    for precision, tolerance in (("float32", 1e-4), (None, 1e-4), ("bfloat16", 2e-2)):
        run = compiled(precision)
        np.testing.assert_allclose(run.work(run.prepare()), losses, rtol=tolerance)
        np.testing.assert_allclose(run.work(run.prepare()), losses, rtol=tolerance)  # again from the beginning


@needs_torch
def test_torch_does_the_same_steps(workload):
    work, compiled = workload
    run = compiled("float32")
    ours = run.work(run.prepare())
    with _torch(work) as peer:
        np.testing.assert_allclose(peer("float32").losses, ours, rtol=1e-4)
        np.testing.assert_allclose(peer("float32").losses, ours, rtol=1e-4)
        assert peer("bfloat16").losses != peer("float32").losses
        assert peer("products").losses == []


def test_products_are_those_of_a_step(workload):
    work, _ = workload
    products = make_products(work)
    assert sum(product.flops for product in products) == step_flops(work)
    assert [product.name for product in products][:3] == ["x w 128x4x64", "x^T g 128x4x64", "x w 128x64x96"]
    sizes = 4 * 64, 64 * 96, 96 * 4
    assert step_flops(work) == 2 * 128 * (3 * sum(sizes) - sizes[0])
    products[0].run()


def test_the_papers_network_has_its_flops():
    experiment = load_experiment(LARGE_NETWORK)
    widths = (4, *experiment.policy.hidden_layers, 4)
    weights = sum(a * b for a, b in itertools.pairwise(widths))
    assert weights == 3_672_064
    assert experiment.training.batch_size == 1024


def test_file_and_table(tmp_path, capsys):
    arguments = ["benchmark", "training", "--steps", "1", "--repetitions", "1", "--output", str(tmp_path / "b.json")]
    small = ["--policy.hidden-layers", "64", "96", "--training.batch-size", "128"]
    assert main([*arguments, *small]) == 0
    printed = capsys.readouterr().out
    result = json.loads((tmp_path / "b.json").read_text())
    assert result["benchmark"] == "training"
    assert result["problem"]["hidden_layers"] == [64, 96]
    metrics = result["metrics"]
    for name in ("ours_float32", "ours_bfloat16", "plain_float32", "products"):
        assert metrics[f"{name}.rate"]["value"] > 0
        assert name in printed
    assert metrics["ours_float32.of_products"]["target"] == 0.85
    assert metrics["ours_float32.over_plain"]["value"] > 0
    if find_spec("torch") is None:
        assert result["methods"]["torch_float32"].startswith("not installed")
        assert "torch_float32: not installed" in printed
    else:
        assert metrics["torch_float32.loss_difference"]["value"] < 1e-4
        assert metrics["ours_float32.over_torch"]["target"] == 1.0
    body = report(result).split("\n\n")[1]
    assert all(word in printed for word in body.split())


def test_without_torch_the_reason_stands_in_the_file(monkeypatch):
    monkeypatch.setattr("agile_jax.benchmark.training.find_spec", lambda name: None)
    experiment = load_experiment(LARGE_NETWORK, {"policy.hidden_layers": [32], "training.batch_size": 16})
    result = benchmark_training(experiment, 1, 1)
    assert {name for name in METHODS if name.startswith("torch")} == {
        name for name, text in result["methods"].items() if text == "not installed: pip install torch"
    }
    assert not any(key.startswith("torch") for key in result["metrics"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--steps", "0"], "--steps = 0: input should be greater than or equal to 1"),
        (["--policy.activation", "relu"], 'policy.activation = "relu": this benchmark knows only "tanh"'),
    ],
)
def test_bad_input(arguments, said, capsys):
    assert main(["benchmark", "training", *arguments]) == 2
    assert said in capsys.readouterr().err
