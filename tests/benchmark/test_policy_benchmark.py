"""The benchmark of the policy: what it measures, and what it says of it."""

import numpy as np
import pytest

from agile_jax.benchmark.policy import BATCH, SPEED_TARGET, _metrics, benchmark_policy, report
from agile_jax.benchmark.subjects import PAPER
from agile_jax.cli import main
from agile_jax.experiment import load_experiment


def test_the_numbers_are_those_of_the_calls():
    found = {
        metric.key: metric
        for metric in _metrics(np.full(30, 100e-6), np.full(3, BATCH * 2e-6), np.array([1e-3, 1e-3, 7e-3]))
    }
    assert found["policy.query_median"].value == pytest.approx(2.0)
    assert found["policy.single_p99"].value == pytest.approx(100.0)
    assert found["expert.solve_mean"].value == pytest.approx(3.0)
    assert found["speed_ratio"].value == pytest.approx(500)
    assert found["speed_ratio"].missed
    assert found["speed_ratio_mean"].value == pytest.approx(1500)
    assert found["speed_ratio_single"].value == pytest.approx(10)


def test_it_measures_policy_and_expert():
    experiment = load_experiment(PAPER, {"policy.hidden_layers": [8, 8], "expert.nodes": 20})
    result = benchmark_policy(experiment, 2)
    metrics = result["metrics"]
    assert 0 < metrics["policy.query_median"]["value"] < metrics["policy.single_median"]["value"]
    assert metrics["speed_ratio"]["target"] == SPEED_TARGET
    text = report(result)
    assert "speed_ratio" in text
    assert ("missed" in text) == (metrics["speed_ratio"]["value"] < SPEED_TARGET)


def test_an_unknown_benchmark_is_refused(capsys):
    assert main(["benchmark", "nothing"]) == 2
    assert "There are: expert" in capsys.readouterr().err
