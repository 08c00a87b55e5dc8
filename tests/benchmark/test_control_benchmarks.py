"""`agile benchmark mpc`, `tracking` and `evaluation` at tiny sizes: real runs, whose numbers say nothing."""

import pathlib

import numpy as np
import pytest

import agile_jax.benchmark.evaluation as evaluation_benchmark
import agile_jax.benchmark.mpc as mpc_benchmark
import agile_jax.benchmark.tracking as tracking_benchmark
from agile_jax.benchmark.workloads.disturbance import Disturbance
from agile_jax.control import ControlSettings
from agile_jax.experiment import load_experiment
from agile_jax.robot import PlantSettings


def test_the_mpc_benchmark_finds_the_optimum_with_every_method(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mpc_benchmark, "BATCHES", (2,))
    monkeypatch.setattr(mpc_benchmark, "PASSES", 1)
    result = mpc_benchmark.benchmark_mpc(ControlSettings(), 2)
    metrics = result["metrics"]
    for name in ("ours_1", "ours_2", "ours_pyramid_2"):
        assert metrics[f"calm.{name}.accurate_share"]["value"] == 1.0
        assert metrics[f"calm.{name}.solves_per_core_second"]["value"] > 0
        assert metrics[f"hard.{name}.cone_violation"]["value"] < 1e-3
    assert metrics["calm.infeasible"]["value"] == 0
    assert "ours_pyramid_2" in mpc_benchmark.report(result)


def test_the_tracking_benchmark_has_a_row_for_each_disturbance(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tracking_benchmark, "TRACKING", {"forward": tracking_benchmark.NOMINAL})
    monkeypatch.setattr(
        tracking_benchmark, "ROBUSTNESS", {"slippery": Disturbance(plant=PlantSettings(foot_friction=0.4))}
    )
    result = tracking_benchmark.benchmark_tracking(load_experiment(table()), 2, 1.2, 0.2, threads=1)
    rows = result["rows"]
    assert [(row["episodes"], row["survived"], row["disturbed"]) for row in rows.values()] == [
        (2, 2, False),
        (2, 2, True),
    ]
    assert 0 < rows["forward"]["velocity_rms_median_m_s"] < 0.5
    assert rows["slippery"]["velocity_rms_median_m_s"] == 0  # nothing counts in the first second
    assert "2 of 2" in tracking_benchmark.report(result)


def test_the_evaluation_benchmark_times_the_parts_of_its_loop(
    finished_run: pathlib.Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(evaluation_benchmark, "CPU_BATCHES", {"mujoco": (2,)})
    monkeypatch.setattr(evaluation_benchmark, "WORKER_BATCHES", ())
    monkeypatch.setattr(evaluation_benchmark, "SIMULATED", 0.04)
    monkeypatch.setattr(evaluation_benchmark, "REPETITIONS", 1)
    experiment = load_experiment(finished_run / "experiment.toml")
    result = evaluation_benchmark.benchmark_evaluation(experiment, finished_run, 1)
    values = {key: metric["value"] for key, metric in result["metrics"].items()}
    assert values["best_speed"] == values["mujoco_2_speed"] > 0
    shares = [values[f"mujoco_2_{part}_share"] for part in ("plan", "act", "physics")]
    assert min(shares) > 0
    assert np.sum(shares) == pytest.approx(1.0)
    assert "without_physics" in evaluation_benchmark.report(result)


def table() -> pathlib.Path:
    return pathlib.Path(evaluation_benchmark.__file__).with_name("table.toml")
