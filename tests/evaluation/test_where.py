"""Episodes in the engine's workers are those of one process, and parts that fail are named."""

import pathlib
from functools import partial

import pytest

from agile_jax.engine import InlineEngine, TasksFailedError, open_engine
from agile_jax.evaluation import evaluate, stage
from agile_jax.experiment import Experiment
from agile_jax.settings import BadInput


def experiment(**evaluation) -> Experiment:
    """Straight to a target 0.3 m ahead, from starts that differ a little."""
    return Experiment.model_validate(
        {
            "name": "near",
            "expert": {"nodes": 20},
            "scene": {
                "target": [0.8, 0.0, 0.28, 0.0],
                "start": {"std": [0.05, 0.05, 0.01, 0.0], "mean": [0.5, 0, 0.28, 0]},
            },
            "evaluation": {"planner": "straight", "episodes": 4, "batch": 2, "traced": 2} | evaluation,
        }
    )


@pytest.fixture
def inline():
    return partial(open_engine, "inline")


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(stage, "CHUNK", 2)


def test_workers_simulate_what_one_process_simulates(tmp_path: pathlib.Path, inline, small_chunks, monkeypatch):
    def files(name: str, where: str) -> list[bytes]:
        assert evaluate(experiment(where=where), tmp_path / name, inline, 1)["success_rate"] == 1.0
        return [(tmp_path / name / "evaluation" / file).read_bytes() for file in ("mujoco.npz", "mujoco-traces.npz")]

    here = files("here", "here")
    assert files("a chunk at a time", "workers") == here
    monkeypatch.setattr(stage, "PARTS_A_WORKER", 1)
    assert files("both chunks in one stream", "workers") == here


@pytest.mark.parametrize(
    ("chunks", "workers", "sizes"), [(1, 2, [1]), (9, 2, [1] * 9), (16, 2, [2] * 8), (157, 2, [8] * 19 + [5])]
)
def test_workers_get_equal_parts(chunks: int, workers: int, sizes: list[int]):
    groups = stage._groups(list(range(chunks)), workers)
    assert [len(group) for group in groups] == sizes
    assert [chunk for group in groups for chunk in group] == list(range(chunks))


class Failing(InlineEngine):
    """All tasks but the first fail."""

    def map(self, function, tasks, time_limit_s=None):
        yield from super().map(refuse_others(function), tasks, time_limit_s)


def refuse_others(function):
    def one(part):
        if getattr(part, "traced", 1) == 0:
            raise MemoryError("no room")
        return function(part)

    return one


def test_parts_that_fail_are_named_and_the_others_kept(tmp_path: pathlib.Path, inline, small_chunks):
    from contextlib import nullcontext

    lame = experiment(where="workers")
    with pytest.raises(
        TasksFailedError, match=r"1 parts of the evaluation failed \(episodes from 2: MemoryError: no room"
    ):
        evaluate(lame, tmp_path, lambda: nullcontext(Failing()), 1)
    assert (tmp_path / "evaluation/mujoco-chunks/episodes-000000.npz").exists()
    assert evaluate(lame, tmp_path, inline, 1)["episodes"] == 4


def test_devices_that_are_not_there_are_refused():
    from agile_jax.evaluation import check_devices

    with pytest.raises(BadInput, match=r"evaluation.devices = 64, but JAX finds 1 \(cpu\)"):
        check_devices(experiment(backend="mjx", devices=64).evaluation)
    with pytest.raises(BadInput, match='"mjx-warp" needs'):
        check_devices(experiment(backend="mjx-warp").evaluation)


def test_a_number_of_episodes_that_is_none_is_refused():
    with pytest.raises(ValueError, match="greater than or equal to 1"):
        experiment(episodes=0)
