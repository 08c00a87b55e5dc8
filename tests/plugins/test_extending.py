"""The examples of docs/extending.md, run as they stand there: each block is a file."""

import os
import pathlib
import re
import runpy
import subprocess
import sys

import numpy as np
import pytest

import agile_jax as aj
from agile_jax import plugins
from agile_jax.robot import RobotSettings, build_mujoco_model
from agile_jax.store.artefact import EPISODES, EXPERT_TIMES, LABELS, key

ROOT = pathlib.Path(__file__).parents[2]
CACHE = {"JAX_COMPILATION_CACHE_DIR": str(ROOT / ".pytest_cache" / "jax"), "JAX_PLATFORMS": "cpu"}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A folder with the files of the page."""
    folder = tmp_path_factory.mktemp("page")
    text = (ROOT / "docs" / "extending.md").read_text()
    for name, content in re.findall(r"```(?:python|toml)\n# (\S+)\n(.*?)```", text, re.DOTALL):
        (folder / name).write_text(content)
    return folder


def agile(folder: pathlib.Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "agile_jax.cli", *arguments]
    environment = os.environ | CACHE | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_another_scene(page: pathlib.Path) -> None:
    path = aj.solve(page / "room.toml", (0.0, 0.0, 0.28, 0.0))
    assert path.status == "solved"
    assert path.min_clearance >= 0.025


def test_another_obstacle_is_passed_and_stands_in_the_physics(page: pathlib.Path) -> None:
    experiment = aj.load_experiment(page / "bench.toml", plugins=[str(page / "bench.py")])
    through = aj.solve(experiment, (0.0, 0.0, 0.28, 0.0))
    assert through.branch == "under"
    assert aj.solve(experiment, (1.5, 1.2, 0.28, 0.0), (1.5, -1.2, 0.28, 0.0)).branch in ("left", "right")
    turned = aj.load_experiment(page / "bench.toml", {"scene.obstacles.0.yaw": np.pi / 2})
    assert aj.solve(turned, (0.0, 0.0, 0.28, 0.0)).branch in ("left", "right")  # a board is in the way
    boxes = through.scene.obstacle_centers
    assert boxes.shape == (3, 3)
    with_bench, without = (
        build_mujoco_model(aj.scene.make_scene(settings), RobotSettings(), 0.002)
        for settings in (experiment.scene, aj.scene.SceneSettings())
    )
    assert with_bench.ngeom >= without.ngeom + 3


def test_an_own_expert_labels_through_worker_processes(page: pathlib.Path) -> None:
    command = ["expert", "straight.toml", "--plugin", "straight.py", "--workers", "2", "--run-dir", "straight"]
    made = agile(page, *command)
    assert made.returncode == 0, made.stderr
    run = aj.open_run(page / "straight", plugins=[str(page / "straight.py")])
    assert run.summary("dataset")["trajectories"] == 6
    with np.load(next((page / "straight" / "dataset").glob("shard-*.npz"))) as shard:
        assert set(shard["method"]) == {"straight"}
    for states in run.dataset.states:
        way = states[:, :4] - states[0, :4]
        along = way @ way[-1] / (way[-1] @ way[-1])
        np.testing.assert_allclose(way, along[:, None] * way[-1], atol=1e-9)  # straight lines
    assert "reused" in agile(page, *command).stdout

    source = (page / "straight.py").read_text()
    (page / "straight.py").write_text(source + "\n# edited\n")
    edited = agile(page, *command)
    (page / "straight.py").write_text(source)
    assert edited.returncode == 2
    assert re.search(r"made with other settings:\n.*plugin", edited.stderr)

    without = agile(page, *command[:2], *command[4:])
    assert without.returncode == 2
    assert "expert.kind = 'straight': must be one of 'minimum_time'" in without.stderr
    assert "--plugin MODULE" in without.stderr


def test_labels_made_elsewhere(page: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(page)
    runpy.run_path("elsewhere.py")
    dataset = aj.dataset.load(page / "elsewhere" / "dataset")
    np.testing.assert_allclose(dataset.starts, [(0.0, 0.0, 0.28, 0.0), (0.2, -1.0, 0.28, 0.3)])


def test_another_version_of_a_plugin_has_another_key(page: pathlib.Path, tmp_path: pathlib.Path) -> None:
    program = (
        "import sys, agile_jax as aj\n"
        "from agile_jax import plugins\n"
        "from agile_jax.store.artefact import LABELS, key\n"
        "plugins.load(['straight.py'])\n"
        "print(key(LABELS, aj.load_experiment('straight.toml').model_dump(mode='json')))"
    )

    def found(addition: str) -> str:
        (tmp_path / "straight.py").write_text((page / "straight.py").read_text() + addition)
        (tmp_path / "straight.toml").write_text((page / "straight.toml").read_text())
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", program]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True).stdout

    first = found("")
    assert first == found("")
    assert first != found("\n# another version\n")


def test_only_what_uses_a_plugin_depends_on_it(page: pathlib.Path) -> None:
    plugins.load([str(page / "waves.py"), str(page / "standing.py"), str(page / "bench.py")])
    inputs = {"epochs": "some"}
    waves = aj.load_experiment(page / "waves.toml").model_dump(mode="json")
    assert set(plugins.digests(waves)) == {"policy"}
    plain = waves | {"policy": aj.policy.PolicySettings().model_dump(mode="json")}
    assert key(LABELS, waves) == key(LABELS, plain)
    assert key(EPISODES, waves, inputs) != key(EPISODES, plain, inputs)
    bench = aj.load_experiment(page / "bench.toml").model_dump(mode="json")
    assert set(plugins.digests(bench)) == {"obstacle"}
    assert key(EXPERT_TIMES, bench) == key(EXPERT_TIMES, bench | {"policy": waves["policy"]})


def test_an_own_policy_and_an_own_controller_through_a_run(page: pathlib.Path) -> None:
    plugins.load([str(page / "waves.py"), str(page / "standing.py")])
    control = {"control.kind": "standing", "control.stiffness": 80.0}
    small = {"evaluation.episodes": 1, "report.video": False, "dataset.shard_size": 12}
    experiment = aj.load_experiment(page / "waves.toml", small | control)
    assert (experiment.policy.waves, experiment.control.stiffness) == (2, 80.0)
    run = aj.run(experiment, page / "waves")

    features = run.policy.policy.encode(np.zeros(4, np.float32)).features
    assert len(features) == 4 + 2 * 3 * 2
    parameters = run.policy.parameters.network["params"]
    assert parameters["Dense_0"]["kernel"].shape == (16, 16)

    episode = run.rollout((0.0, 0.0, 0.28, 0.0))  # it stands where it is until the time is over
    assert episode.outcome == "timeout"
    assert np.hypot(*(episode.poses[:, :2] - episode.poses[0, :2]).T).max() < 0.05
    np.testing.assert_allclose(episode.trace.qpos[-1, 7:], episode.trace.qpos[0, 7:], atol=0.1)


def test_another_physics(page: pathlib.Path, finished_run: pathlib.Path) -> None:
    (page / "runs").symlink_to(finished_run.parent)
    environment = os.environ | CACHE | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run([sys.executable, "windy.py"], cwd=page, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert re.fullmatch(r"(success|collision|fall|timeout) \d\.\d+ s\n", ended.stdout)
