"""The pipeline's bookkeeping, with a real (small) dataset stage: reuse, refusal, moving aside, locks, kills."""

import fcntl
import json
import pathlib
import shutil
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

from agile_jax import pipeline
from agile_jax.api.run import open_run
from agile_jax.dataset import load
from agile_jax.experiment import Experiment, load_experiment, with_overrides
from agile_jax.files import write_json
from agile_jax.report.outdated import meta, summaries
from agile_jax.report.page import page
from agile_jax.run_directory import begun_record, finish_record, locked, stage_paths, stage_state
from agile_jax.scene import make_scene
from agile_jax.settings import BadInput
from agile_jax.training import load_policy

SMALL = {
    "dataset.trajectories": 12,
    "dataset.shard_size": 2,
    "expert.nodes": 20,
    "expert.initial_velocity": "free",
}


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    base = pathlib.Path(__file__).parents[1] / "experiments" / "base.toml"
    return load_experiment(base, SMALL)


@pytest.fixture(scope="module")
def finished(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A run directory whose dataset is done. Tests leave it as it is."""
    run_dir = tmp_path_factory.mktemp("runs") / "finished"
    result = pipeline.run(experiment, run_dir, ("dataset",), engine="inline")["dataset"]
    assert not result.reused
    assert result.summary["trajectories"] == 12
    return run_dir


def snapshot(folder: pathlib.Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_a_run_directory_tells_what_it_is(experiment: Experiment, finished: pathlib.Path) -> None:
    assert load_experiment(finished / "experiment.toml") == experiment
    environment = json.loads((finished / "environment.json").read_text())
    assert environment["packages"]["casadi"]
    assert environment["seed"] == experiment.seed
    record = json.loads((finished / "dataset/stage.json").read_text())
    assert record["stage"] == "dataset"
    assert record["key"] == environment["keys"]["dataset"]
    assert record["amounts"] == {"dataset.trajectories": 12}
    shards = {f"dataset/shard-{i:05d}.npz" for i in range(6)}
    assert record["files"].keys() == shards | {"dataset/manifest.json", "dataset/summary.json"}
    assert record["settings"]["expert.nodes"] == 20


def test_the_second_time_nothing_is_done(experiment: Experiment, finished: pathlib.Path) -> None:
    before = snapshot(finished / "dataset")
    result = pipeline.run(experiment, finished, ("dataset",), engine="tcp://127.0.0.1:1")["dataset"]
    assert result.reused
    assert snapshot(finished / "dataset") == before


def test_other_settings_are_refused_with_every_difference(experiment: Experiment, finished: pathlib.Path) -> None:
    before = snapshot(finished)
    other = with_overrides(experiment, {"expert.nodes": 30, "seed": 7, "training.epochs": 1}, "test")
    with pytest.raises(BadInput) as caught:
        pipeline.run(other, finished, engine="inline")
    text = str(caught.value)
    assert "expert.nodes: 20 there, 30 asked for" in text
    assert "seed: 0 there, 7 asked for" in text
    assert "training" not in text  # the dataset does not depend on it
    assert "--run-dir" in text
    assert "--overwrite" in text
    assert snapshot(finished) == before


def test_overwrite_moves_the_old_folders_aside(experiment: Experiment, tmp_path: pathlib.Path) -> None:
    few = with_overrides(experiment, {"dataset.trajectories": 1}, "test")
    pipeline.run(few, tmp_path, ("dataset",), engine="inline")
    old = (tmp_path / "dataset/manifest.json").read_bytes()
    write_json(tmp_path / "evaluation/mujoco.json", {"of": "another policy"})
    for number, seed in enumerate((1, 2), start=1):
        other = with_overrides(few, {"seed": seed}, "test")
        pipeline.run(other, tmp_path, ("dataset",), engine="inline", overwrite=True)
        assert (tmp_path / f"dataset.old-{number}").is_dir()
    assert (tmp_path / "dataset.old-1/manifest.json").read_bytes() == old
    assert (tmp_path / "evaluation/mujoco.json").exists()  # evaluations of several policies stand side by side


def test_bad_input_writes_nothing(experiment: Experiment, tmp_path: pathlib.Path) -> None:
    for arguments in ({"engine": "carrier-pigeon"}, {"engine": "inline", "workers": 0}):
        with pytest.raises(BadInput):
            pipeline.run(experiment, tmp_path / "run", ("dataset",), **arguments)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_record_is_not_taken_for_a_result(experiment: Experiment, tmp_path: pathlib.Path) -> None:
    (tmp_path / "dataset").mkdir()
    assert stage_state(tmp_path, experiment, "dataset") == "new"
    (tmp_path / "dataset/.stage.json.abc.tmp").touch()  # what a kill during the very first write leaves
    assert stage_state(tmp_path, experiment, "dataset") == "new"
    (tmp_path / "dataset/thesis.txt").touch()
    with pytest.raises(BadInput, match="nothing tells with which settings"):
        pipeline.run(experiment, tmp_path, ("dataset",), engine="inline")
    (tmp_path / "dataset/stage.json").write_text('{"hash": ')
    with pytest.raises(BadInput, match="nothing tells with which settings"):
        pipeline.run(experiment, tmp_path, ("dataset",), engine="inline")


DAMAGE = {
    "a flipped bit": lambda data: data[:300] + bytes([data[300] ^ 1]) + data[301:],
    "another digit": lambda data: data.replace(b"7", b"8", 1),
    "cut off": lambda data: data[: len(data) // 2],
    "gone": lambda data: None,
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("name", ["shard-00003.npz", "manifest.json", "summary.json", "stage.json"])
def test_damage_after_the_end_is_never_used_and_repaired_to_the_same_bytes(
    experiment: Experiment, finished: pathlib.Path, tmp_path: pathlib.Path, name: str, damage: str
) -> None:
    run_dir = shutil.copytree(finished, tmp_path / "run")
    path = run_dir / "dataset" / name
    before = {name: data for name, (_, data) in snapshot(run_dir / "dataset").items()}
    if (data := DAMAGE[damage](path.read_bytes())) is None:
        path.unlink()
    else:
        path.write_bytes(data)
        assert data != before[name]
    assert stage_state(run_dir, experiment, "dataset") == "begun"
    told = pipeline.forecast(experiment, run_dir, ("dataset",))["dataset"]
    assert told == f"is damaged (dataset/{name}), will be repaired" or (name == "stage.json" and "will go on" in told)
    pipeline.run(experiment, run_dir, ("dataset",), engine="inline", store="none")
    after = {name: data for name, (_, data) in snapshot(run_dir / "dataset").items() if "quarantine" not in name}
    after.pop("timing.json"), before.pop("timing.json")
    if name == "shard-00003.npz":  # how long its solves took, again
        for contents in (before, after):
            contents.pop("stage.json")
            summary = json.loads(contents.pop("summary.json"))
            assert summary.pop("labels_per_second") > 0
            assert summary.pop("solve_time_ms_median") > 0
            contents["summary"] = json.dumps(summary).encode()
    assert after == before
    assert stage_state(run_dir, experiment, "dataset") == "done"


def test_a_dataset_grows_and_shrinks_without_loss(
    experiment: Experiment, finished: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    run_dir = shutil.copytree(finished, tmp_path / "run")
    shards = {path.name: path.read_bytes() for path in run_dir.glob("dataset/shard-*.npz")}
    hashes = {}
    for count in (15, 7, 12):  # 15 fills half a shard; 7 is less than what is there
        other = with_overrides(experiment, {"dataset.trajectories": count}, "test")
        assert "dataset.trajectories" in pipeline.forecast(other, run_dir, ("dataset",))["dataset"]
        summary = pipeline.run(other, run_dir, ("dataset",), engine="inline", store="none")["dataset"].summary
        assert summary["attempted"] == count
        assert len(load(run_dir / "dataset").indices) == summary["trajectories"]
        hashes[count] = summary["dataset_hash"]
        assert {name: (run_dir / "dataset" / name).read_bytes() for name in shards} == shards
    assert hashes[12] == json.loads((finished / "dataset/summary.json").read_text())["dataset_hash"]
    seven = with_overrides(experiment, {"dataset.trajectories": 7}, "test")
    alone = pipeline.run(seven, tmp_path / "seven", ("dataset",), engine="inline", store="none")["dataset"].summary
    assert alone["dataset_hash"] == hashes[7]


def test_run_directories_side_by_side_make_equal_labels_once(
    experiment: Experiment, finished: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    few = with_overrides(experiment, {"dataset.trajectories": 4}, "test")
    pipeline.run(few, tmp_path / "one", ("dataset",), engine="inline")
    nowhere = "tcp://127.0.0.1:1"  # no engine is needed
    other = with_overrides(few, {"name": "other", "training.epochs": 3}, "test")
    summary = pipeline.run(other, tmp_path / "two", ("dataset",), engine=nowhere)["dataset"].summary
    one, two = (
        {path.name: path.read_bytes() for path in (tmp_path / run).glob("dataset/*.*") if path.name != "stage.json"}
        for run in ("one", "two")
    )
    assert one == two
    assert summary["labels_per_second"] > 0


def test_a_run_directory_that_is_removed_during_the_work_is_an_error(
    experiment: Experiment, tmp_path: pathlib.Path
) -> None:
    run_dir = tmp_path / "run"

    def remove(work: str, done: int, total: int, note: str = "") -> None:
        if done == 6:
            shutil.rmtree(run_dir)

    with pytest.raises(OSError, match="was removed or replaced during the work"):
        pipeline.run(experiment, run_dir, ("dataset",), engine="inline", store="none", progress=remove)
    assert stage_state(run_dir, experiment, "dataset") != "done"
    pipeline.run(experiment, run_dir, ("dataset",), engine="inline", store="none")
    assert stage_state(run_dir, experiment, "dataset") == "done"


def test_evaluations_stand_side_by_side(experiment: Experiment, tmp_path: pathlib.Path) -> None:
    mjx = with_overrides(experiment, {"evaluation.backend": "mjx"}, "test")
    write_json(stage_paths(tmp_path, experiment, "evaluation").summary, {})
    finish_record(tmp_path, experiment, "evaluation")
    assert stage_state(tmp_path, experiment, "evaluation") == "done"
    assert stage_state(tmp_path, mjx, "evaluation") == "new"
    other = with_overrides(experiment, {"evaluation.seed": 99}, "test")
    assert stage_state(tmp_path, other, "evaluation") == "new"  # made anew, not refused
    more = with_overrides(experiment, {"evaluation.episodes": 99}, "test")
    assert stage_state(tmp_path, more, "evaluation") == "begun"
    for key, value in (("batch", 3), ("where", "workers"), ("devices", 2), ("threads", 3)):
        if key in type(experiment.evaluation).model_fields:
            same = with_overrides(experiment, {f"evaluation.{key}": value}, "test")
            assert stage_state(tmp_path, same, "evaluation") == "done", key
    assert [path.name for path in (tmp_path / "evaluation").glob("*.json")] == ["mujoco.json"]


def test_a_report_is_made_anew_when_a_result_changes(experiment: Experiment, tmp_path: pathlib.Path) -> None:
    write_json(tmp_path / "evaluation/mujoco.json", {"success_rate": 0.5})
    (tmp_path / "report.html").write_text("<html><body>good</body>")
    finish_record(tmp_path, experiment, "report")
    assert stage_state(tmp_path, experiment, "report") == "done"
    write_json(tmp_path / "evaluation/mujoco.json", {"success_rate": 0.6})
    assert stage_state(tmp_path, experiment, "report") == "outdated"
    finish_record(tmp_path, experiment, "report")
    assert stage_state(tmp_path, experiment, "report") == "done"
    write_json(tmp_path / "evaluation/mjx.json", {"success_rate": 0.5})
    assert stage_state(tmp_path, experiment, "report") == "outdated"


def test_a_new_result_marks_the_report_that_tells_of_the_old_one(
    experiment: Experiment, tmp_path: pathlib.Path
) -> None:
    run_dir = tmp_path / "run"
    pipeline.run(experiment, run_dir, ("dataset",), engine="inline")
    told = page("demo", "", [], meta(summaries(run_dir)))
    (run_dir / "report.html").write_text(told)
    pipeline.run(experiment, run_dir, ("dataset",), engine="inline")
    assert (run_dir / "report.html").read_text() == told
    other = with_overrides(experiment, {"expert.nodes": 24}, "test")
    pipeline.run(other, run_dir, ("dataset",), engine="inline", overwrite=True)
    assert "since it was written, dataset/summary.json changed" in (run_dir / "report.html").read_text()


def test_one_process_at_a_time(experiment: Experiment, tmp_path: pathlib.Path) -> None:
    program = (
        "import pathlib, sys, time\nfrom agile_jax.run_directory import locked\n"
        "with locked(pathlib.Path(sys.argv[1])):\n    print('held', flush=True)\n    time.sleep(60)"
    )
    holder = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(BadInput, match=rf"another process \(pid {holder.pid}\) is at work here"):
            pipeline.run(experiment, tmp_path, ("dataset",), engine="inline")
        assert not (tmp_path / "dataset").exists()
    finally:
        holder.kill()
        holder.wait()
    with locked(tmp_path), open(tmp_path / ".lock") as file, pytest.raises(BlockingIOError):  # a kill freed it
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_failures_are_named() -> None:
    def result(summary: dict[str, Any]) -> dict[str, pipeline.StageResult]:
        return {"dataset": pipeline.StageResult("dataset", False, pathlib.Path(), summary)}

    assert pipeline.failures(result({"unverified": 0})) == []
    assert "3 trajectories" in pipeline.failures(result({"unverified": 3}))[0]
    assert pipeline.failures({}) == []


def test_killed_and_resumed_is_bit_for_bit_the_same(
    experiment: Experiment, finished: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    command = [sys.executable, "-m", "agile_jax.cli", "expert", str(finished / "experiment.toml"), "--engine", "inline"]
    command += ["--run-dir", str(tmp_path / "run")]
    shards = tmp_path / "run" / "dataset"
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not list(shards.glob("shard-*.npz")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not (shards / "summary.json").exists()
    assert stage_state(tmp_path / "run", experiment, "dataset") == "begun"
    assert subprocess.run(command, capture_output=True).returncode == 0
    for path in sorted(finished.glob("dataset/shard-*.npz")):
        assert (shards / path.name).read_bytes() == path.read_bytes()
    hashes = [
        json.loads((folder / "summary.json").read_text())["dataset_hash"] for folder in (shards, finished / "dataset")
    ]
    assert hashes[0] == hashes[1]


BRIEF = {
    "policy.hidden_layers": [8],
    "training.batch_size": 16,
    "training.epochs": 4,
    "training.checkpoint_every": 2,
    "kinematic_test.every": 0,
    "kinematic_test.starts": 4,
}


@pytest.fixture(scope="module")
def trained(experiment: Experiment, finished: pathlib.Path, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A run directory whose training is done, too."""
    run_dir = shutil.copytree(finished, tmp_path_factory.mktemp("trained") / "run")
    pipeline.run(with_overrides(experiment, BRIEF, "test"), run_dir, ("training",), engine="inline")
    return run_dir


@pytest.mark.parametrize("damage", ["a flipped bit", "gone"])
def test_a_training_whose_last_checkpoint_is_damaged_is_not_done_nor_read_and_is_repaired(
    experiment: Experiment, trained: pathlib.Path, tmp_path: pathlib.Path, damage: str
) -> None:
    brief, run_dir = with_overrides(experiment, BRIEF, "test"), shutil.copytree(trained, tmp_path / "run")
    start = experiment.scene.start.mean
    expected = open_run(trained).policy(np.array(start))
    step = run_dir / "training" / "checkpoints" / "4"
    file = max((step / "policy").rglob("*"), key=lambda path: path.stat().st_size if path.is_file() else 0)
    if (data := DAMAGE[damage](file.read_bytes())) is None:
        shutil.rmtree(step)
    else:
        file.write_bytes(data)
    assert stage_state(run_dir, brief, "training") == "begun"
    with pytest.raises(BadInput, match="agile train"):
        open_run(run_dir).export()
    limits, settings = brief.expert.limits, brief.policy
    with pytest.raises(BadInput, match=r"checkpoints/4: .*`agile train .*run` goes on from the last sound checkpoint"):
        load_policy(run_dir / "training", make_scene(brief.scene), limits, settings)
    pipeline.run(brief, run_dir, ("training",), engine="inline")
    assert stage_state(run_dir, brief, "training") == "done"
    np.testing.assert_array_equal(open_run(run_dir).policy(np.array(start)), expected)
    for name in ("metrics.jsonl", "kinematic_test.npz", "test_errors.npz"):
        assert (run_dir / "training" / name).read_bytes() == (trained / "training" / name).read_bytes()


def test_an_evaluation_is_of_the_policys_numbers_not_of_the_files_that_hold_them(
    experiment: Experiment, trained: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    brief, run_dir = with_overrides(experiment, BRIEF, "test"), shutil.copytree(trained, tmp_path / "run")
    before = begun_record(run_dir, brief, "evaluation").inputs
    shutil.rmtree(run_dir / "training" / "checkpoints" / "4")
    pipeline.run(brief, run_dir, ("training",), engine="inline")
    assert begun_record(run_dir, brief, "evaluation").inputs == before != {}
