"""The benchmark of the expert: honest peers, measures that agree with the verifier, and the file that it writes."""

import itertools
import json
import pathlib
import subprocess
import sys

import numpy as np
import pytest

from agile_jax.benchmark.expert import benchmark_expert, report
from agile_jax.benchmark.metrics import Metric, as_json, table
from agile_jax.benchmark.peers.opti_peer import make_opti_peer
from agile_jax.benchmark.peers.peer_path import PeerPath, dense_poses, integrate, measure
from agile_jax.benchmark.peers.rockit_peer import make_rockit_peer, rockit_is_installed
from agile_jax.benchmark.subjects import PAPER
from agile_jax.cli import main
from agile_jax.experiment import load_experiment
from agile_jax.expert import ExpertSettings, integrate as integrate_label, make_expert, minimum_time, verify
from agile_jax.expert.verify import dense_poses as dense_label
from agile_jax.scene import SceneSettings, clearance, make_scene

SETTINGS = ExpertSettings(nodes=60)
NODES_CLEAR = 1e-6  # [m] what the solver may fall short of a constraint at a node

needs_rockit = pytest.mark.skipif(not rockit_is_installed(), reason="rockit is not installed")
PEERS = [
    pytest.param(lambda *arguments: make_opti_peer(*arguments, 0.0), id="opti"),
    pytest.param(lambda *arguments: make_opti_peer(*arguments, 5e-3), id="opti_smooth"),
    pytest.param(lambda *arguments: make_rockit_peer(*arguments, 5e-3), id="rockit", marks=needs_rockit),
]


@pytest.fixture(scope="module")
def table_scene():
    return make_scene(load_experiment(PAPER).scene)


@pytest.mark.parametrize("make", PEERS)
@pytest.mark.parametrize(("condition", "nodes"), [("rest", 60), ("free", 60), ("rest", 240)])
def test_peers_reach_the_analytic_time_without_obstacles(make, condition, nodes):
    scene = make_scene(SceneSettings())
    settings = SETTINGS.model_copy(update={"initial_velocity": condition, "nodes": nodes})
    solve = make(scene, settings)
    for start in ([0.0, 0.5, 0.2, 0.4], [2.9, 1.8, 0.3, -0.3]):
        start = np.array(start)
        solution = solve(start)
        assert solution.success, solution.status
        bounds = np.array(settings.velocity), np.array(settings.acceleration)
        expected = minimum_time(scene.target - start, *bounds, condition).max()
        # A switch of the control that falls between two nodes costs a part of one interval.
        assert solution.path.times[-1] == pytest.approx(expected, rel=0.2 / nodes)
        assert solution.path.times[-1] >= expected * (1 - 1e-4)
        defects = measure(scene, settings, solution.path)
        assert defects.bounds < 1e-6
        assert defects.clearance == 0
        assert defects.dynamics < 2e-3  # of the trapezoidal rule, h^2 (u_N - u_0) / 12
        np.testing.assert_allclose(solution.path.states[0, :4], start, atol=1e-7)
        np.testing.assert_allclose(solution.path.states[-1], [*scene.target, 0, 0, 0, 0], atol=1e-7)


@pytest.mark.parametrize("make", PEERS)
def test_peers_avoid_the_same_table(make, table_scene):
    solution = make(table_scene, SETTINGS)(np.array([0.3, 0.1, 0.26, 0.0]))
    assert solution.success, solution.status
    path = solution.path
    crossing = np.abs(path.states[:, 0] - 1.5) < 0.25 + table_scene.torso_half_size[0]
    assert crossing.any()
    # The smoothed maximum falls short of the margin by its width times log 2 at an edge, the exact clearance does not.
    assert clearance(table_scene, path.states[:, :4]).min() >= SETTINGS.clearance_margin - NODES_CLEAR


def test_measures_agree_with_the_verifier_and_see_what_is_wrong(table_scene):
    start = np.array([0.3, 0.1, 0.26, 0.2])
    label = make_expert(table_scene, SETTINGS).solve(start)
    times, states, controls = label.trajectory
    path = PeerPath(times, states, controls, controls)
    check = verify(table_scene, SETTINGS, label.trajectory, start)
    np.testing.assert_allclose(integrate(path), integrate_label(label.trajectory), atol=1e-12)
    np.testing.assert_allclose(dense_poses(path), dense_label(label.trajectory), atol=1e-12)
    found = measure(table_scene, SETTINGS, path)
    assert found.clearance == check.clearance_violation == 0
    assert found.bounds == check.bound_violation
    lifted = states + np.array([0, 0, 0.01, 0, 0, 0, 0, 0])
    assert measure(table_scene, SETTINGS, path._replace(states=lifted)).clearance > 0.005
    bent = states.copy()
    bent[30, 1] += 0.02
    assert measure(table_scene, SETTINGS, path._replace(states=bent)).dynamics == pytest.approx(0.02, rel=1e-3)


def test_linear_accelerations_are_integrated_exactly():
    """s = t^3, one axis with u = 6 t, on an uneven grid."""
    times = np.array([0.0, 0.1, 0.4, 1.0])
    states, axis = np.zeros((4, 8)), 2
    states[:, axis], states[:, 4 + axis] = times**3, 3 * times**2
    first, last = np.zeros((3, 4)), np.zeros((3, 4))
    first[:, axis], last[:, axis] = 6 * times[:-1], 6 * times[1:]
    path = PeerPath(times, states, first, last)
    np.testing.assert_allclose(integrate(path), states, atol=1e-14)
    dense = dense_poses(path, 3)[:, axis]
    fine = np.concatenate([np.linspace(a, b, 5)[:-1] for a, b in itertools.pairwise(times)] + [[1.0]])
    np.testing.assert_allclose(dense, fine**3, atol=1e-14)


def test_a_target_is_missed_on_its_wrong_side_only():
    assert Metric("k", 9.0, "", "higher", "", 10.0).missed
    assert not Metric("k", 11.0, "", "higher", "", 10.0).missed
    assert Metric("k", 2e-4, "", "lower", "", 1e-4).missed
    assert not Metric("k", None, "", "lower", "", 1e-4).missed
    found = as_json([Metric("opti.solved", 1, "", "", ""), Metric("opti.speed_ratio", 9.0, "", "higher", "fast", 10.0)])
    text = report({"experiment": "n", "problem": {"starts": 1}, "peers": {}, "metrics": found})
    assert text.endswith("missed: opti.speed_ratio is 9, its target 10 (fast)")
    assert table(["one", "two"], [("row", ["1", "22222"])]) == "     one    two\nrow    1  22222"


def test_numbers_of_a_small_run_fit_together():
    experiment = load_experiment(PAPER, {"expert.nodes": 40})
    calls = []
    result = benchmark_expert(experiment, 3, lambda *call: calls.append(call))
    metrics = {key: metric["value"] for key, metric in result["metrics"].items()}
    rows = result["starts"]
    assert len(rows) == 3
    assert calls[-1][:3] == ("measuring", 3, 3)
    assert metrics["ours.solved"] == metrics["ours.accepted"] == 3
    assert metrics["ours.worst_clearance_violation"] == 0
    for peer in ("opti", "opti_smooth"):
        assert metrics[f"{peer}.solved"] == sum(row[peer]["solved"] for row in rows)
        both = [row for row in rows if row[peer]["solved"]]
        excess = [row["ours"]["duration_s"] / row[peer]["duration_s"] - 1 for row in both]
        assert metrics[f"{peer}.excess_worst"] == max(excess)
        assert metrics[f"{peer}.longer"] == sum(x > 1e-4 for x in excess)
        ratio = metrics["ours.solved_per_core_second"] / metrics[f"{peer}.solved_per_core_second"]
        assert metrics[f"{peer}.speed_ratio"] == pytest.approx(ratio)
        assert metrics[f"{peer}.solve_time_median"] == np.median([row[peer]["solve_ms"] for row in rows])


def test_the_command_writes_its_file_in_one_thread(tmp_path: pathlib.Path) -> None:
    output = tmp_path / "deep" / "expert.json"
    command = [sys.executable, "-m", "agile_jax.cli", "benchmark", "expert", "--starts", "2", "--expert.nodes", "30"]
    done = subprocess.run([*command, "--output", str(output)], capture_output=True, text=True, check=True)
    result = json.loads(output.read_text())
    assert {"benchmark", "experiment", "method", "peers", "problem", "machine", "software", "metrics", "starts"} <= set(
        result
    )
    assert result["problem"]["nodes"] == 30
    assert len(result["starts"]) == 2
    for metric in result["metrics"].values():
        assert set(metric) == {"value", "unit", "better", "meaning", "target"}
        assert metric["meaning"]
    for name in ("opti", "ours"):
        assert result["metrics"][f"{name}.cores_used"]["value"] < 1.1
    lines = done.stdout.splitlines()
    assert any(line.startswith("solve_time_p95 [ms]") for line in lines)
    assert ("rockit: not installed" in done.stdout) is not rockit_is_installed()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "which benchmark? There are: expert"),
        (["experts"], "There are: expert, training, mpc, policy, tracking, evaluation, not experts"),
        (["expert", "nowhere.toml"], "nowhere.toml: no such file"),
        (["expert", "--starts", "0"], "--starts = 0: input should be greater than or equal to 1"),
        (["expert", "--expert.nodes", "1"], "expert.nodes = 1"),
    ],
)
def test_bad_input(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", *arguments]) == 2
    assert words in capsys.readouterr().err
