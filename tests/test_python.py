"""The package from Python: names, a finished run as an object, and the script of docs/python.md."""

import os
import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest

import agile_jax as aj
from agile_jax.experiment import Experiment

ROOT = pathlib.Path(__file__).parents[1]
QUICKSTART = ROOT / "experiments" / "quickstart.toml"
START = (0.0, 0.0, 0.28, 0.0)


def test_every_name_is_there_and_completed() -> None:
    for name in aj.__all__:
        assert getattr(aj, name) is not None
    assert set(aj.__all__) <= set(dir(aj))
    assert {"make_policy", "PolicySettings"} <= set(dir(aj.policy))
    assert not {name for name in dir(aj) if not name.startswith("_")} - set(aj.__all__)


def test_a_name_is_not_taken_by_a_module_that_is_loaded_later() -> None:
    program = "import agile_jax.api.run, agile_jax as aj\nassert callable(aj.run) and callable(aj.solve)"
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize("given", [str, pathlib.Path, aj.load_experiment, lambda path: aj.load_experiment(path).scene])
def test_solve_takes_a_file_an_experiment_or_a_scene(given) -> None:
    path = aj.solve(given(QUICKSTART), START)
    assert path.duration == pytest.approx(11 / 3, abs=1e-6)  # 3 m at 1 m/s, and 1 m/s over 1.5 m/s^2 once
    assert (path.branch, repr(path)) == ("under", "SolvedPath(under, 3.667 s, gap 0 %)")


def test_solve_draws_on_axes_that_it_is_given() -> None:
    from matplotlib.figure import Figure

    path = aj.solve(QUICKSTART, START)
    ax = Figure().add_subplot()
    assert path.plot(ax) is ax
    drawn = max((line.get_xydata() for line in ax.lines), key=len)
    np.testing.assert_allclose(drawn[[0, -1]], [[0.0, 0.0], [3.0, 0.0]], atol=1e-6)
    assert path.plot() is not ax


def test_a_second_path_on_the_same_axes_has_its_own_colour_in_the_same_scene() -> None:
    ax = aj.solve(QUICKSTART, START).plot()
    right = ax.get_xlim()[1]
    aj.solve(QUICKSTART, (-1.0, 0.5, 0.28, 0.0)).plot(ax)
    first, second = (line for line in ax.lines if len(line.get_xdata()) > 10)
    assert first.get_color() != second.get_color()
    assert len([text for text in ax.get_legend().get_texts()]) == 3  # two paths and the target
    assert ax.get_xlim()[0] < -1.0
    assert ax.get_xlim()[1] == right


def test_solve_refuses_a_start_that_is_not_free() -> None:
    with pytest.raises(aj.BadInput, match=r"start.*obstacle 0"):
        aj.solve(QUICKSTART, (1.5, 0.0, 0.28, 0.0))
    with pytest.raises(aj.BadInput, match="4 finite numbers"):
        aj.solve(QUICKSTART, (0.0, 0.0, 0.28))


def test_a_path_that_is_not_there_says_why() -> None:
    walls = [{"kind": "box", "position": [1.5, 0.0, 0.5], "size": [0.2, 9.0, 1.0]}]
    path = aj.solve(Experiment.model_validate({"name": "wall", "scene": {"obstacles": walls}}), START)
    assert path.status == "failed"
    with pytest.raises(ValueError, match=re.escape(path.cause)):
        path.plot()


def test_an_unfinished_run_names_the_command(tmp_path: pathlib.Path) -> None:
    with pytest.raises(aj.BadInput, match="no such run directory; `agile run"):
        aj.open_run(tmp_path / "nowhere")
    experiment = aj.load_experiment(QUICKSTART)
    run = aj.Run(tmp_path, experiment)
    for what, command in ({"dataset": "expert", "policy": "train", "episodes": "evaluate"}).items():
        with pytest.raises(aj.BadInput, match=f"is not finished; `agile {command} {tmp_path}` makes it"):
            getattr(run, what)
    with pytest.raises(aj.BadInput, match="stages are dataset, training, evaluation, report"):
        run.summary("figures")


def test_a_finished_run(finished_run: pathlib.Path) -> None:
    run = aj.open_run(str(finished_run))
    assert repr(run) == f"Run({finished_run}: dataset, training, evaluation, report done)"
    assert len(run.dataset.times) == run.summary("dataset")["trajectories"] == 16
    assert run.expert.solve(run.dataset.starts[0]).duration == pytest.approx(run.dataset.durations[0], rel=1e-6)

    poses = run.dataset.states[:3, 50, :4]
    velocities = run.policy.batch(poses)
    np.testing.assert_allclose(velocities[1], run.policy(poses[1]), rtol=1e-4, atol=1e-5)
    assert (np.abs(velocities) <= np.array(run.experiment.expert.velocity) * 1.001).all()

    assert len(run.episodes["success"]) == 2
    assert run.episodes["success"].mean() == run.summary("evaluation")["success_rate"]


def test_a_table_for_pandas(finished_run: pathlib.Path) -> None:
    episodes = aj.open_run(finished_run).episodes
    try:
        import pandas
    except ModuleNotFoundError:
        with pytest.raises(aj.BadInput, match="pip install pandas"):
            episodes.to_pandas()
        return
    table = episodes.to_pandas()
    assert isinstance(table, pandas.DataFrame)
    assert len(table) == 2
    np.testing.assert_array_equal(table["start_3"], episodes["start"][:, 3])


def test_labels_and_training_in_memory_are_those_of_a_run(finished_run: pathlib.Path) -> None:
    run = aj.open_run(finished_run)
    dataset = aj.make_dataset(run.experiment)
    np.testing.assert_array_equal(dataset.states, run.dataset.states)
    policy = aj.train(dataset, run.experiment)
    poses = dataset.states[:3, 50, :4]
    np.testing.assert_array_equal(policy.batch(poses), run.policy.batch(poses))


def test_the_scripts_of_the_page(finished_run: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """As a file without a main guard, in a folder where the experiments and a finished run are."""
    script = "\n".join(re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), re.DOTALL))
    (tmp_path / "script.py").write_text(script)
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    (tmp_path / "runs").symlink_to(finished_run.parent)
    cache = {"JAX_COMPILATION_CACHE_DIR": str(ROOT / ".pytest_cache" / "jax"), "JAX_PLATFORMS": "cpu"}
    environment = os.environ | cache | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert "SolvedPath(under, 3.667 s, gap 0 %) (61, 8)" in ended.stdout
    assert re.search(r"RecordedEpisode\((success|collision|fall|timeout), \d+ moments\)", ended.stdout)
    assert (tmp_path / "under_the_table.png").stat().st_size > 10_000
    assert re.search(r"\n\[[^]]*\]\n$", ended.stdout)  # the velocity of the policy that was trained in memory
