"""The command line: exit codes, one clear message for bad input, nothing written."""

import json
import os
import pathlib
from collections.abc import Callable

import numpy as np
import pytest

from agile_jax.cli import COMMANDS, main

BASE = pathlib.Path(__file__).parents[1] / "experiments" / "base.toml"
FILES = {
    "good.toml": "",
    "typo.toml": "[training]\nepoch = 3",
    "negative.toml": "[[scene.obstacles]]\nkind = 'table'\nposition = [1.5, 0.0]\nsize = [-0.5, 1.0]\nunderside = 0.25",
    "nan.toml": "[training]\nlearning_rate = nan",
    "inside.toml": "[scene]\ntarget = [1.5, 0.0, 0.28, 0.0]",
    "type.toml": "[training]\nepochs = 'many'",
    "far.toml": "[study]\nvary = 'seed'\nvalues = [1, -1]",
    "close.toml": "[scene]\ntarget = [2.04, 0.0, 0.28, 0.0]",
    "filter.toml": "[policy]\nfilter_margin = 0.03",
    "rounds.toml": "[aggregation]\nrounds = 1",
    "blocked.toml": "[scene.start]\nmean = [1.5, 0.0, 0.28, 0.0]\nstd = [0.0, 0.0, 0.0, 0.0]",
    "feedback.toml": "[expert]\ninitial_velocity = 'free'\n[policy]\nkind = 'feedback'",
}
SMALL = ["--dataset.trajectories", "4", "--dataset.shard-size", "1", "--expert.nodes", "20", "--engine", "inline"]


@pytest.fixture
def folder(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> pathlib.Path:
    """The working directory of a test, with experiment files in it."""
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(f'extends = "{BASE}"\nname = "n"\n{text}\n')
    (tmp_path / "circle.toml").write_text('extends = "circle.toml"')
    return tmp_path


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def call(*arguments: str) -> tuple[int, str, str]:
        try:
            code = main(arguments)
        except SystemExit as ended:  # after --help
            code = int(ended.code or 0)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


Call = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["run", "typo.toml"], "typo.toml: training.epoch: unknown key; did you mean training.epochs?"),
        (["run", "negative.toml"], "negative.toml: scene.obstacles.0.size.0 = -0.5: input should be greater than 0"),
        (["run", "nan.toml"], "nan.toml: training.learning_rate = nan: must be a finite number"),
        (
            ["expert", "inside.toml"],
            "inside.toml: scene.target = [1.5, 0.0, 0.28, 0.0] puts the torso inside obstacle 0",
        ),
        (
            ["run", "close.toml"],
            "close.toml: scene.target = [2.04, 0.0, 0.28, 0.0] puts the torso 0.0100 m from obstacle 0",
        ),
        (["run", "rounds.toml"], 'it needs expert.initial_velocity = "free"'),
        (["run", "feedback.toml"], 'it needs expert.initial_velocity = "rest"'),
        (["export", "nowhere"], "nowhere: no such run directory"),
        (["run", "filter.toml"], "policy.filter_margin = 0.03 must be below expert.clearance_margin = 0.025"),
        (["train", "type.toml"], "type.toml: training.epochs = 'many': input should be a valid integer"),
        (["run", "god.toml"], "god.toml: no such file; did you mean good.toml?"),
        (["run", "circle.toml"], "goes round in a circle"),
        (["run", "."], ".: is a folder"),
        (["run"], "which experiment? usage: agile run EXPERIMENT.toml"),
        (["runn", "good.toml"], "runn: unknown command; did you mean `agile run`?"),
        (
            ["run", "good.toml", "--training.epoch", "3"],
            "--training.epoch: unknown option; did you mean --training.epochs?",
        ),
        (
            ["run", "good.toml", "--training.epochs", "3.5"],
            "command line: training.epochs = 3.5: input should be a valid integer",
        ),
        (["run", "good.toml", "--training.epochs"], "--training.epochs: needs a value"),
        (
            ["run", "good.toml", "--training.epochs", "-3"],
            "command line: training.epochs = -3: input should be greater",
        ),
        (
            ["run", "good.toml", "--training.learning-rate", "nan"],
            "command line: training.learning_rate = nan: must be",
        ),
        (["run", "good.toml", "--policy.kind", "plian"], "did you mean 'plain'?"),
        (["run", "good.toml", "--scene.target", "1.5", "0", "0.28", "0"], "puts the torso inside obstacle 0"),
        (
            ["run", "good.toml", "--engine", "pigeon"],
            'engine address "pigeon" is none of "local", "inline", "tcp://host:port"',
        ),
        (
            ["run", "good.toml", "--workers", "0"],
            "command line: --workers = 0: input should be greater than or equal to 1",
        ),
        (["sweep", "good.toml"], "no [sweep] table"),
        (["study", "good.toml"], "no [study] table"),
        (["study", "far.toml"], "study: seed = -1: input should be greater than or equal to 0"),
        (["status", "nowhere"], "nowhere: is no folder of a run, a sweep or a study"),
        (["plan", "good.toml"], "command line: --start: is missing"),
        (["plan", "good.toml", "--start", "0", "0", "0.28"], "--start = [0, 0, 0.28]: must have 4 values, not 3"),
        (["plan", "good.toml", "--start", "0", "0", "0.28", "90"], "[rad]; 90 degrees are 1.571"),
        (
            ["plan", "good.toml", "--start", "0", "9", "9", "0"],
            "start y = 9 m is outside its bounds [-3, 3] m start z = 9 m",
        ),
        (["run", "god_example.toml"], "god_example.toml: no such file"),
        (
            ["run", "good.toml", "--workers", "0", "--seed", "-1"],
            "--workers = 0: input should be greater than or equal to 1 command line: seed = -1",
        ),
        (
            ["run", "good.toml", "--training.epoch", "3", "--seed", "-1"],
            "did you mean --training.epochs? command line: seed = -1",
        ),
        (["run", "good.toml", "--dataset.targets", "2", "0"], "--dataset.targets: is written as in a file, in quotes"),
        (["run", "blocked.toml"], "blocked.toml: scene.start: 0 of 10240 starts are free (mean [1.5, 0.0, 0.28, 0.0]"),
        (["plan", "good.toml", "--start", "1.5", "0", "0.28", "0"], "puts the torso inside obstacle 0"),
        (["plan", "good.toml", "--start", "0", "0", "9", "0"], "start z = 9 m is outside its bounds [0.155, 0.32] m"),
        (["plan", "good.toml", "--start", "0", "0", "nan", "0"], "finite"),
        (
            ["plan", "good.toml", "--start", "0", "0", "0.28", "0", "--target", "1.5", "0", "0.28", "0"],
            "target = [1.5, 0.0, 0.28, 0.0] puts the torso inside obstacle 0",
        ),
        (
            ["plan", "good.toml", "--start", "0", "0", "0.28", "0", "--target", "1.5", "0", "9", "0"],
            "target z = 9 m is outside its bounds",
        ),
        (["rollout", "nowhere", "--start", "0", "0", "0.28", "0"], "nowhere: no such run directory"),
        (["rollout", ".", "--start", "0", "0", "0.28", "0"], "experiment.toml: no such file"),
        (["rollout"], "which run directory?"),
        (["schema", "x"], "takes no arguments"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input(arguments: list[str], part: str, folder: pathlib.Path, call: Call) -> None:
    before = sorted(folder.rglob("*"))
    code, out, err = call(*arguments)
    assert code == 2
    assert out == ""
    assert part in " ".join(err.split())
    assert "Traceback" not in err
    assert err.count("agile: ") == 1
    assert sorted(folder.rglob("*")) == before


def test_help_is_everywhere(folder: pathlib.Path, call: Call) -> None:
    code, out, _ = call("--help")
    assert code == 0
    assert all(f"agile {name}" in out for name in COMMANDS)
    for name in COMMANDS:
        code, out, _ = call(name, "--help")
        assert code == 0
        assert f"usage: agile {name}" in out
    code, out, _ = call("run", "good.toml", "--help")
    assert len(out.splitlines()) < 70  # what matters, not all
    assert "--training.epochs" in out
    for words in (["--help", "scene"], ["--help-scene"], ["--help-all"]):
        code, out, _ = call("run", "good.toml", *words)
        assert code == 0
        assert "--scene.obstacles.0.underside FLOAT" in out  # the file's table
        assert ("--training.momentum" in out) == (words == ["--help-all"])
        assert max(map(len, out.splitlines())) <= 100
    assert "`agile benchmark mpc --help SECTION`" in call("benchmark", "mpc", "--help")[1]
    assert call()[0] == 2


def test_the_version(call: Call) -> None:
    assert call("--version")[1].startswith("agile_jax 0.")


def test_the_schema_is_json(call: Call) -> None:
    code, out, _ = call("schema")
    assert code == 0
    assert {"name", "extends", "scene", "sweep"} <= set(json.loads(out)["properties"])


def test_a_dry_run_writes_nothing(folder: pathlib.Path, call: Call) -> None:
    before = sorted(folder.rglob("*"))
    code, out, _ = call("run", "good.toml", "--dry-run")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()[1:]] == ["dataset", "training", "evaluation", "report"]
    assert "runs/n" in out
    assert sorted(folder.rglob("*")) == before


def test_options_may_come_first_and_in_either_spelling(folder: pathlib.Path, call: Call) -> None:
    code, out, _ = call("run", "--dry-run", "--seed", "4", "--training.learning_rate", "0.1", "good.toml")
    assert code == 0
    assert "will be made" in out


def test_an_option_repairs_a_bad_value_of_the_file(folder: pathlib.Path, call: Call) -> None:
    assert call("run", "type.toml", "--dry-run")[0] == 2
    assert call("run", "type.toml", "--dry-run", "--training.epochs", "3")[0] == 0
    assert call("run", "negative.toml", "--dry-run", "--scene.obstacles.0.size", "0.5", "1")[0] == 0


def test_home_is_expanded_where_the_shell_left_it(
    folder: pathlib.Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(folder / "home"))
    code, out, _ = call("run", "good.toml", "--dry-run", "--run-dir", "~/x")
    assert code == 0
    assert f"n in {folder / 'home/x'}:" in out


def test_a_missing_home_is_no_error_unless_it_is_asked_for(
    folder: pathlib.Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere(path: str) -> str:
        return path

    monkeypatch.delenv("HOME")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setattr(os.path, "expanduser", nowhere)  # as where the user is not in the list of users
    assert call("run", "good.toml", "--dry-run")[0] == 0
    code, _, err = call("run", "good.toml", "--dry-run", "--run-dir", "~/x")
    assert code == 2
    assert "agile: --run-dir ~/x: there is no home directory" in err


def test_a_folder_whose_name_is_no_text_is_refused(folder: pathlib.Path, call: Call) -> None:
    code, _, err = call("expert", "good.toml", *SMALL, "--run-dir", os.fsdecode(b"run-\xff"))
    assert code == 2
    assert "is not UTF-8 text; use another folder" in err
    assert sorted(path.name for path in folder.iterdir()) == sorted([*FILES, "circle.toml"])


def test_commands_go_on_in_a_run_directory(folder: pathlib.Path, call: Call) -> None:
    (folder / "elsewhere").mkdir()
    (folder / "elsewhere/experiment.toml").write_text((folder / "good.toml").read_text())
    for command in ("run", "expert", "train", "evaluate", "report"):
        code, out, _ = call(command, "elsewhere", "--dry-run")
        assert code == 0
        assert out.startswith("n in elsewhere:")
    code, _, err = call("run", "home", "--dry-run")
    assert code == 2
    (folder / "empty").mkdir()
    code, _, err = call("run", "empty", "--dry-run")
    assert code == 2
    assert "empty: is a folder without an experiment.toml; name an experiment or a run directory" in err


def test_expert_runs_and_is_reused_and_refused(folder: pathlib.Path, call: Call) -> None:
    code, out, err = call("expert", "good.toml", *SMALL)
    assert code == 0
    assert "dataset" in out
    assert "made" in out
    assert "4 trajectories" in out
    assert "4/4 (100 %)" in err
    code, out, _ = call("expert", "good.toml", *SMALL)
    assert code == 0
    assert "reused" in out
    code, _, err = call("expert", "good.toml", *SMALL, "--expert.nodes", "25")
    assert code == 2
    assert "expert.nodes: 20 there, 25 asked for" in err
    code, out, _ = call("expert", "good.toml", *SMALL, "--expert.nodes", "25", "--overwrite", "--dry-run")
    assert code == 0
    assert "moved aside" in out
    code, _, err = call("rollout", "runs/n", "--start", "0", "0", "0.28", "0")
    assert code == 2
    assert "training is not finished" in err


def test_rollout_replays_what_an_unstable_episode_left(folder: pathlib.Path, call: Call) -> None:
    from agile_jax.evaluation.traces import save_traces
    from agile_jax.simulation import Trace

    qpos = np.zeros((5, 19))
    qpos[:, 2], qpos[:, 3] = [0.3, 0.31, 0.4, 0.9, np.nan], 1.0
    qvel = np.zeros((5, 18))
    qvel[3, 2] = 25.0
    solver = np.zeros(5, np.int32), np.zeros(5), np.zeros((5, 12), bool)
    trace = Trace(np.arange(1, 6) / 50, qpos, qvel, np.full((5, 12), 3.0), np.zeros((5, 8)), *solver, np.ones(5))
    (folder / "done").mkdir()
    (folder / "done" / "experiment.toml").write_text((folder / "good.toml").read_text())
    save_traces(folder / "episode.npz", [trace])
    code, out, _ = call("rollout", "done", "--replay", "episode.npz")
    assert code == 0
    assert dict(line.split() for line in out.splitlines()) == {
        "from_s": "0.02",
        "to_s": "0.1",
        "first_bad_sample_s": "0.1",
        "last_good_height_m": "0.9",
        "largest_speed_m_s": "25",
        "largest_joint_speed_rad_s": "0",
        "largest_torque_nm": "3",
        "reference_is_finite": "True",
    }
    code, _, err = call("rollout", "done", "--replay", "good.toml")
    assert code == 2
    assert "good.toml: holds no recorded episodes" in err
    code, _, err = call("rollout", "done")
    assert code == 2
    assert "either --start X Y Z YAW or --replay FILE" in err


@pytest.mark.parametrize("labels", ["rest", "free"])
def test_plan_prints_and_draws(labels: str, folder: pathlib.Path, call: Call) -> None:
    """From rest to rest, however the labels begin."""
    start = ["--start", "-0.5", "0", "0.28", "0", "--expert.initial-velocity", labels]
    code, out, _ = call("plan", "good.toml", *start, "--output", "deep/plan.png", "--expert.nodes", "40")
    assert code == 0
    numbers = {line[:14].strip(): line[14:] for line in out.splitlines()}
    # x is the slowest axis: 3.5 m at 1 m/s, speeding up and braking at 1.5 m/s^2
    assert float(numbers["duration"].split()[0]) == pytest.approx(3.5 + 1 / 1.5, rel=2e-3)
    assert numbers["branch"] == "under"
    assert (folder / "deep/plan.png").read_bytes().startswith(b"\x89PNG")


def test_plan_to_another_target(folder: pathlib.Path, call: Call) -> None:
    target = ["--target", "0.2", "-1", "0.28", "-3", "--output", "None", "--expert.nodes", "20"]
    code, out, _ = call("plan", "good.toml", "--start", "0", "0", "0.28", "3", *target)
    assert code == 0
    assert float(out.split()[1]) == pytest.approx(1 / 0.5 + 0.5 / 1.5, abs=1e-3)  # sideways, and the shorter turn


def test_plan_draws_into_the_current_folder_if_not_told_where(folder: pathlib.Path, call: Call) -> None:
    code, out, _ = call("plan", "good.toml", "--start", "2.5", "1", "0.28", "0", "--expert.nodes", "20")
    assert code == 0
    assert out.splitlines()[-1].split() == ["drawing", "plan.png"]
    assert (folder / "plan.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("command", ["run", "evaluate", "report", "sweep", "study", "rollout"])
def test_an_opengl_that_nobody_knows_is_one_line(
    command: str, folder: pathlib.Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "garbage")
    code, out, err = call(command, "good.toml")
    assert (code, out) == (2, "")
    assert err.startswith("agile: MUJOCO_GL = 'garbage' in the environment is none of MuJoCo's words")
    assert len(err.splitlines()) == 1


def test_an_opengl_that_is_not_here_is_named_and_dropped(
    folder: pathlib.Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "OpenGL").mkdir()  # hides PyOpenGL from the probe
    (folder / "OpenGL/__init__.py").write_text("raise AttributeError('no library')")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    code, _, err = call("run", "good.toml", "--dry-run")
    assert code == 0
    assert err == "agile: MUJOCO_GL=osmesa does not work here (AttributeError: no library); going on without it\n"
    assert "MUJOCO_GL" not in os.environ


def test_a_run_dir_that_cannot_be_is_one_line(folder: pathlib.Path, call: Call) -> None:
    (folder / "file").touch()
    code, _, err = call("expert", "good.toml", *SMALL, "--run-dir", "file/run")
    assert code == 2
    assert err.splitlines() == ["agile: file: is a file, where a folder is needed; use another folder"]
