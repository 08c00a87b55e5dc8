"""A run directory with the shapes of a real one, in which the robot's true motion is known."""

import json
import pathlib

import numpy as np
import pytest
from known_run import write_traces

from agile_jax.scene import Scene, SceneSettings, TableSettings, make_scene


@pytest.fixture(scope="session")
def scene_settings() -> SceneSettings:
    table = TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25)
    return SceneSettings(obstacles=(table,))


@pytest.fixture(scope="session")
def scene(scene_settings: SceneSettings) -> Scene:
    return make_scene(scene_settings)


@pytest.fixture
def run_dir(tmp_path: pathlib.Path) -> pathlib.Path:
    """A finished run: episode 0 failed, 1 went around the table, 2 went under it."""
    run = tmp_path / "demo"
    for stage in ("dataset", "training", "evaluation"):
        (run / stage).mkdir(parents=True)
    (run / "experiment.toml").write_text('name = "demo"\n[scene]\ntarget = [3.0, 0.0, 0.28, 0.0]\n')
    (run / "environment.json").write_text(json.dumps({"packages": {"jax": "0.10.2"}, "seed": 0}))
    dataset = {
        "trajectories": 397, "attempted": 440, "rejected_starts": 40, "failed": {"infeasible": 3}, "unverified": 0,
        "branches": {"under": 390, "left": 7}, "optimality_gap_median": 0.0123, "labels_per_second": 31.0,
        "solve_time_ms_median": 61.0, "workers": 2, "max_clearance_violation_m": 0.0, "max_dynamics_residual": 1e-9,
        "dataset_hash": "0123abcd",
    }  # fmt: skip
    training = {
        "train_mse": 0.004,
        "validation_mse": 0.005,
        "test_mse": 0.0051,
        "noise_floor_mse": 0.0025,
        "epochs": 20,
    }
    evaluation = {
        "backend": "mujoco", "episodes": 64,
        "success_rate": 0.9375, "success_rate_low": 0.85, "success_rate_high": 0.975,
        "failures": {"collision": 2, "fall": 1, "timeout": 1, "unstable": 0}, "arrival_time_ratio_median": 1.31,
    }  # fmt: skip
    (run / "dataset/summary.json").write_text(json.dumps(dataset))
    (run / "training/summary.json").write_text(json.dumps(training))
    (run / "evaluation/mujoco.json").write_text(json.dumps(evaluation))
    lines = [{"epoch": e, "train_mse": 0.1 * 0.8**e, "validation_mse": 0.11 * 0.82**e} for e in range(20)]
    (run / "training/metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines) + '{"epoch": 2')
    generator = np.random.default_rng(1)
    outcome = np.zeros(64, np.int8)
    outcome[[0, 10, 20, 30]] = [1, 1, 2, 3]
    start = np.array([0.5, 0.066, 0.26, 0.0]) + generator.normal(size=(64, 4)) * [0.5, 0.66, 0.02, 0.0]
    np.savez(run / "evaluation/mujoco.npz", start=start, outcome=outcome)
    write_traces(run / "evaluation", [0.0, 0.9, 0.1])
    return run
