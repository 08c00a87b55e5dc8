"""Episodes in the engine's workers are those of one process, and parts that fail are named."""

import pathlib
from contextlib import nullcontext
from functools import partial

import pytest
from near import near

from agile_jax.engine import InlineEngine, TasksFailedError, open_engine
from agile_jax.evaluation import episodes
from agile_jax.evaluation.stage import evaluate
from agile_jax.settings import BadInput

INLINE = partial(open_engine, "inline")


@pytest.fixture
def small_files(monkeypatch):
    monkeypatch.setattr(episodes, "FILE", 2)


def test_workers_simulate_what_one_process_simulates(tmp_path: pathlib.Path, small_files, monkeypatch):
    def files(name: str, where: str) -> list[bytes]:
        pushed = near(where=where, plant={"push_impulse": (0.5, 2.0), "delay": (0.0, 0.004)})  # each episode's own
        assert evaluate(pushed, tmp_path / name, INLINE)["success_rate"] == 1.0
        return [(tmp_path / name / "evaluation" / file).read_bytes() for file in ("mujoco.npz", "mujoco-traces.npz")]

    here = files("here", "here")
    assert files("a file at a time", "workers") == here
    monkeypatch.setattr(episodes, "PARTS_A_WORKER", 1)
    assert files("both in one stream", "workers") == here


@pytest.mark.parametrize(
    ("count", "workers", "sizes"),
    [(60, 2, [60]), (576, 2, [64] * 9), (1024, 2, [128] * 8), (10_000, 2, [512] * 19 + [272])],
)
def test_workers_get_equal_parts(count: int, workers: int, sizes: list[int]):
    parts = [range(count)[rows] for rows in episodes.split(count, workers)]
    assert [len(part) for part in parts] == sizes
    assert [episode for part in parts for episode in part] == list(range(count))


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


def test_parts_that_fail_are_named_and_the_others_kept(tmp_path: pathlib.Path, small_files):
    lame = near(where="workers")
    with pytest.raises(
        TasksFailedError, match=r"1 parts of the evaluation failed \(episodes from 2: MemoryError: no room"
    ):
        evaluate(lame, tmp_path, lambda: nullcontext(Failing()))
    (part,) = tmp_path.glob("evaluation/kept/*/episodes-*.npz")
    made = part.stat().st_mtime_ns
    assert evaluate(lame, tmp_path, INLINE)["episodes"] == 4
    assert part.stat().st_mtime_ns == made


def test_devices_that_are_not_there_are_refused():
    from agile_jax.evaluation import check_devices

    with pytest.raises(BadInput, match=r"evaluation.devices = 64, but JAX finds 1 \(cpu\)"):
        check_devices(near(backend="mjx", devices=64).evaluation)
    with pytest.raises(BadInput, match='"mjx-warp" needs'):
        check_devices(near(backend="mjx-warp").evaluation)


def test_a_number_of_episodes_that_is_none_is_refused():
    with pytest.raises(ValueError, match="greater than or equal to 1"):
        near(episodes=0)
