"""Parts: only what is missing, damaged or of another question is done, and the bytes do not depend on how."""

from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest

from agile_jax.dataset import ask, expert_times
from agile_jax.engine import open_engine
from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import SceneSettings, TableSettings, make_scene
from agile_jax.store.parts import complete_parts

INLINE = partial(open_engine, "inline")
TABLE = TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25)
SCENE, EXPERT = SceneSettings(obstacles=(TABLE,)), ExpertSettings(nodes=20)
STARTS = np.array([[0.5, 0.1, 0.26, 0.0], [0.2, -0.7, 0.28, 0.0], [1.5, 0.0, 0.3, 0.0]])  # the last is in the table


def squares(numbers):
    if (numbers == 13).any():
        raise ValueError("unlucky")
    return {"number": numbers, "square": numbers**2}


@contextmanager
def no_engine():
    raise AssertionError("nothing is missing")
    yield


@pytest.fixture
def finished(tmp_path):
    tasks = [np.arange(3), np.arange(3, 5), np.arange(5, 9)]
    return tmp_path, tasks, complete_parts(tmp_path, "key", squares, tasks, INLINE, 10.0)


def test_parts_are_joined_in_order_and_not_done_twice(finished):
    folder, tasks, (arrays, digest) = finished
    np.testing.assert_array_equal(arrays["square"], np.arange(9) ** 2)
    again, same = complete_parts(folder, "key", squares, tasks, no_engine, 10.0)
    np.testing.assert_array_equal(again["number"], np.arange(9))
    assert same == digest


@pytest.mark.parametrize("fault", ["deleted", "truncated", "flipped bit"])
def test_a_damaged_part_alone_is_done_again_to_the_same_bytes(finished, fault):
    folder, tasks, (_, digest) = finished
    path = folder / "part-00001.npz"
    before, data = {p.name: p.stat().st_mtime_ns for p in folder.iterdir()}, bytearray(path.read_bytes())
    sound = bytes(data)
    if fault == "deleted":
        path.unlink()
    elif fault == "truncated":
        path.write_bytes(data[: len(data) // 2])
    else:
        data[data.index(np.arange(3, 5).tobytes())] ^= 1
        path.write_bytes(data)
    assert complete_parts(folder, "key", squares, tasks, INLINE, 10.0)[1] == digest
    assert path.read_bytes() == sound
    assert {p.name for p in folder.iterdir() if p.stat().st_mtime_ns != before[p.name]} == {path.name}


def test_another_question_is_asked_anew(finished):
    folder, tasks, (_, digest) = finished
    assert complete_parts(folder, "other", squares, tasks, INLINE, 10.0)[1] != digest
    with pytest.raises(AssertionError):
        complete_parts(folder, "key", squares, tasks, no_engine, 10.0)


def test_a_failed_part_is_named_and_the_others_are_kept(tmp_path):
    tasks = [np.arange(3), np.array([13]), np.arange(5)]
    with pytest.raises(RuntimeError, match=r"part-00001\.npz: ValueError: unlucky; the other parts are kept"):
        complete_parts(tmp_path, "key", squares, tasks, INLINE, 10.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["part-00000.npz", "part-00002.npz"]


def test_expert_times_and_answers_are_the_experts(tmp_path):
    expert = make_expert(make_scene(SCENE), EXPERT)
    times, arrivals, branches = expert_times(SCENE, EXPERT, STARTS, INLINE, tmp_path / "times")
    assert np.isnan(times[2])
    assert np.isnan(arrivals[2])
    answers = ask(SCENE, EXPERT, STARTS, INLINE, tmp_path / "queries")
    assert answers.asked == 3
    assert answers.states.shape == (2, 21, 8)
    for i in range(2):
        rest = expert.solve(STARTS[i], initial_velocity="rest")
        assert times[i] == rest.duration
        assert branches[i] == rest.branch
        away = np.hypot(*(rest.trajectory.states[:, :2] - make_scene(SCENE).target[:2]).T) > 0.1
        last = np.flatnonzero(away)[-1]
        assert rest.trajectory.times[last] < arrivals[i] <= rest.trajectory.times[last + 1] < rest.duration
        free = expert.solve(STARTS[i], initial_velocity="free").trajectory
        np.testing.assert_array_equal(answers.states[i], free.states)
        np.testing.assert_array_equal(answers.times[i], free.times)
    assert ask(SCENE, EXPERT, STARTS, no_engine, tmp_path / "queries").digest == answers.digest
