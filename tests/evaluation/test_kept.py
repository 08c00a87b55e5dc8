"""What exists is kept, what is missing is made, and what depends on other things is made beside it."""

import json
import pathlib
from functools import partial

import numpy as np
import pytest
from near import near
from quadruped import tiny
from threadpoolctl import threadpool_limits

from agile_jax.dataset import unseen_starts
from agile_jax.engine import open_engine
from agile_jax.evaluation import compare
from agile_jax.evaluation.stage import evaluate, evaluation_starts
from agile_jax.evaluation.traces import load_traces
from agile_jax.experiment import load_experiment
from agile_jax.expert import planning_margin
from agile_jax.scene import clearance, make_scene
from agile_jax.settings import BadInput
from agile_jax.sweep.numbers import NUMBERS

INLINE = partial(open_engine, "inline")


def parts(run: pathlib.Path) -> dict[pathlib.Path, int]:
    """Files of episodes, and when each was written."""
    return {path: path.stat().st_mtime_ns for path in run.glob("evaluation/kept/*/episodes-*.npz")}


def columns(run: pathlib.Path) -> dict[str, np.ndarray]:
    with np.load(run / "evaluation/mujoco.npz") as file:
        return dict(file)


def test_starts_do_not_depend_on_how_many_there_are():
    few, many = evaluation_starts(near(episodes=3)), evaluation_starts(near(episodes=300))
    np.testing.assert_array_equal(few, many[:3])
    experiment = near()
    same = unseen_starts(experiment.scene, experiment.expert, 3, (0, 7_001, 0))
    np.testing.assert_array_equal(few, same)


def test_starts_keep_the_margin_that_labels_keep():
    """From closer by the expert has no path, and a rollout is refused."""
    table = {"kind": "table", "position": [0.5, 0.0], "size": [0.4, 0.6], "underside": 0.25}
    start = {"mean": [0.5, 0.0, 0.28, 0.0], "std": [0.3, 0.3, 0.04, 0.3]}
    experiment = near(scene={"obstacles": [table], "start": start, "target": [2.0, 0.0, 0.28, 0.0]}, episodes=4000)
    distances = clearance(make_scene(experiment.scene), evaluation_starts(experiment))
    margin = experiment.expert.clearance_margin
    assert (distances < margin + 0.005).any()  # many are near
    assert distances.min() >= planning_margin(experiment.expert) > margin


def test_more_episodes_other_batches_and_records_keep_what_is_there(tmp_path: pathlib.Path):
    evaluate(near(), tmp_path, INLINE)
    first, episodes = parts(tmp_path), columns(tmp_path)
    recorded = (tmp_path / "evaluation/mujoco-traces.npz").read_bytes()
    for same in (near(batch=3), near(threads=1), near(where="workers"), near(devices=1, name="again")):
        evaluate(same, tmp_path, INLINE)
        assert parts(tmp_path) == first
        assert (tmp_path / "evaluation/mujoco-traces.npz").read_bytes() == recorded

    assert evaluate(near(episodes=3, traced=0), tmp_path, INLINE)["episodes"] == 3
    assert parts(tmp_path) == first
    assert not (tmp_path / "evaluation/mujoco-traces.npz").exists()

    evaluate(near(episodes=6, traced=3), tmp_path, INLINE)
    assert first.items() <= parts(tmp_path).items()
    more = columns(tmp_path)
    assert len(more["outcome"]) == 6
    for name, values in episodes.items():
        np.testing.assert_array_equal(values, more[name][:4], err_msg=name)
    assert len(load_traces(tmp_path / "evaluation/mujoco-traces.npz")) == 3


def test_threads_of_the_blas_change_nothing(tmp_path: pathlib.Path):
    for threads in (1, 2):
        with threadpool_limits(threads, user_api="blas"):
            evaluate(near(traced=0), tmp_path / str(threads), INLINE)
    one, two = columns(tmp_path / "1"), columns(tmp_path / "2")
    for name, values in one.items():
        np.testing.assert_array_equal(values, two[name], err_msg=name)


def test_another_controller_is_another_evaluation_beside_the_first(tmp_path: pathlib.Path):
    slow, fast = near(control={"mpc": {"horizon": 8}}, name="short"), near(episodes=4)
    evaluate(fast, tmp_path, INLINE)
    first, summary = parts(tmp_path), (tmp_path / "evaluation/mujoco.json").read_bytes()
    key = json.loads(summary)["evaluation_key"]
    evaluate(slow, tmp_path, INLINE)
    assert first.items() < parts(tmp_path).items()
    assert json.loads((tmp_path / "evaluation/mujoco.json").read_bytes())["evaluation_key"] != key
    result = compare(f"{tmp_path}:{key[:8]}", f"{tmp_path}:short")
    assert (result["episodes"], result["both"]) == (4, 4)
    assert compare(f"{tmp_path}:mujoco", f"{tmp_path}:short")["arrival_time_ratio_median"] == 1.0
    with pytest.raises(BadInput, match=f"no evaluation is called 'long'; it has .*{key[:12]}"):
        compare(f"{tmp_path}:long", tmp_path)
    both = parts(tmp_path)
    evaluate(fast, tmp_path, INLINE)  # the first is what was asked for last again
    assert parts(tmp_path) == both
    assert (tmp_path / "evaluation/mujoco.json").read_bytes() == summary


def test_damage_is_found_and_made_again(tmp_path: pathlib.Path):
    evaluate(near(), tmp_path, INLINE)
    evaluation = tmp_path / "evaluation"
    episodes, summary = columns(tmp_path), json.loads((evaluation / "mujoco.json").read_bytes())
    assert {key for key, value in summary.items() if isinstance(value, int | float)} <= set(NUMBERS["evaluation"])
    recorded = (evaluation / "mujoco-traces.npz").read_bytes()
    (evaluation / "mujoco.json").write_text(json.dumps(summary | {"success_rate": 0.9}))
    (part,) = parts(tmp_path)
    trace = part.parent / "traces/episode-000001.npz"
    for path in (part, trace):
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)
    evaluate(near(), tmp_path, INLINE)
    assert json.loads((evaluation / "mujoco.json").read_bytes())["success_rate"] == summary["success_rate"]
    assert (evaluation / "mujoco-traces.npz").read_bytes() == recorded
    for name, values in columns(tmp_path).items():
        np.testing.assert_array_equal(values, episodes[name], err_msg=name)


def test_a_robot_whose_included_file_changes_is_evaluated_anew(tmp_path: pathlib.Path):
    (tmp_path / "main.xml").write_text('<mujoco><include file="body.xml"/></mujoco>')
    scene = {"target": [0.5, 0.0, 0.27, 0.0], "torso_half_size": [0.23, 0.11, 0.06]}
    work = []
    for mass in (6.9, 40.0):
        (tmp_path / "body.xml").write_text(tiny(('mass="5"', f'mass="{mass}"')))
        experiment = near(robot={"name": str(tmp_path / "main.xml")}, scene=scene, episodes=1, traced=0)
        evaluate(experiment, tmp_path / "run", INLINE)
        work.append(float(columns(tmp_path / "run")["work"][0]))
    assert len(parts(tmp_path / "run")) == 2
    assert work[1] != work[0]


def test_an_evaluation_can_be_named_in_a_file(tmp_path: pathlib.Path):
    file = tmp_path / "named.toml"
    file.write_text('name = "named"\n[evaluation]\nname = "long-steps"\n')
    assert load_experiment(file).evaluation.name == "long-steps"
    file.write_text('name = "named"\n[evaluation]\nname = "../up"\n')
    with pytest.raises(BadInput, match=r"evaluation\.name"):
        load_experiment(file)
