"""Parts: only what is missing, damaged or of another key is made, and the bytes do not depend on how."""

import subprocess
import sys
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest

from agile_jax.dataset import ask, expert_times
from agile_jax.engine import open_engine
from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import SceneSettings, TableSettings, make_scene
from agile_jax.store.parts import Made, Parts, complete
from agile_jax.store.shared import publish, sharing, take

INLINE = partial(open_engine, "inline")
TABLE = TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25)
SCENE, EXPERT = SceneSettings(obstacles=(TABLE,)), ExpertSettings(nodes=20)
STARTS = np.array([[0.5, 0.1, 0.26, 0.0], [0.2, -0.7, 0.28, 0.0], [1.5, 0.0, 0.3, 0.0]])  # the last is in the table
ASKED: list[int] = []


def squares(numbers):
    ASKED.extend(numbers.tolist())
    if (numbers == 13).any():
        raise ValueError("unlucky")
    return Made({"square": numbers**2}, {"seconds": 1.0, "numbers": numbers.tolist()})


@contextmanager
def no_engine():
    raise AssertionError("nothing is missing")
    yield


def do(folder, count=9, key="key", engine=INLINE, items=None):
    ASKED.clear()
    parts = Parts(folder, "squares", key, np.arange(count) if items is None else items, 4)
    complete(parts, squares, lambda numbers: parts.items[numbers], engine, 10.0)
    return parts


@pytest.fixture
def finished(tmp_path):
    return tmp_path, do(tmp_path)


def part_bytes(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("part-*.npz"))}


def test_parts_are_joined_in_order_and_not_done_twice(finished):
    folder, parts = finished
    np.testing.assert_array_equal(parts.arrays()["square"], np.arange(9) ** 2)
    again = do(folder, engine=no_engine)
    np.testing.assert_array_equal(again.arrays()["item"], np.arange(9))
    assert again.digest() == parts.digest()
    assert again.notes == parts.notes


@pytest.mark.parametrize("fault", ["deleted", "truncated", "flipped bit", "another array"])
def test_a_damaged_part_alone_is_done_again_to_the_same_bytes(finished, fault):
    folder, parts = finished
    path = folder / "part-00001.npz"
    before, data = {p.name: p.stat().st_mtime_ns for p in folder.glob("part-*")}, bytearray(path.read_bytes())
    sound = bytes(data)
    if fault == "deleted":
        path.unlink()
    elif fault == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif fault == "another array":
        np.save(path.open("wb"), np.arange(3))
    else:
        data[data.index((np.arange(4, 8) ** 2).tobytes())] ^= 1
        path.write_bytes(data)
    assert do(folder).digest() == parts.digest()
    assert ASKED == [4, 5, 6, 7]
    assert path.read_bytes() == sound
    assert {p.name for p in folder.glob("part-*") if p.stat().st_mtime_ns != before[p.name]} == {path.name}


def test_more_items_keep_those_that_are_there_and_the_bytes_are_those_of_all_at_once(finished, tmp_path):
    folder, _ = finished
    grown = do(folder, 14 - 3)  # the last part, of one item, is filled up to three
    assert ASKED == [9, 10]
    assert grown.notes["part-00002.npz"] == {"seconds": 2.0, "numbers": [8, 9, 10], "workers": 1}
    at_once = do(tmp_path / "at once", 11)
    assert part_bytes(folder) == part_bytes(tmp_path / "at once")
    assert grown.digest() == at_once.digest()


def test_fewer_items_lose_nothing_and_have_the_digest_of_the_fewer_alone(finished, tmp_path):
    folder, parts = finished
    before = part_bytes(folder)
    fewer = do(folder, 6, engine=no_engine)
    np.testing.assert_array_equal(fewer.arrays()["square"], np.arange(6) ** 2)
    assert part_bytes(folder) == before
    assert fewer.digest() == do(tmp_path / "fewer", 6).digest() != parts.digest()
    assert do(folder, engine=no_engine).digest() == parts.digest()


def test_other_items_of_a_part_are_made_and_the_known_ones_kept(tmp_path):
    do(tmp_path, items=np.array([3, 5, 7]))
    parts = do(tmp_path, items=np.array([7, 4, 3]))
    assert ASKED == [4]
    np.testing.assert_array_equal(parts.arrays()["square"], [49, 16, 9])
    assert do(tmp_path, items=np.array([3, 5, 7]), engine=no_engine).done() == 3


def test_another_question_is_asked_anew_and_the_old_answers_are_set_aside(finished):
    folder, parts = finished
    old = part_bytes(folder)
    assert do(folder, key="other").digest() != parts.digest()
    assert len(ASKED) == 9
    assert sorted(path.read_bytes() for path in (folder / "quarantine").iterdir()) == sorted(old.values())


def test_a_failed_part_is_named_and_the_others_are_kept(tmp_path):
    with pytest.raises(RuntimeError, match=r"part-00003\.npz: ValueError: unlucky\); the others are kept"):
        do(tmp_path, 18)
    assert list(part_bytes(tmp_path)) == [f"part-0000{i}.npz" for i in (0, 1, 2, 4)]


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


def test_expert_times_depend_on_the_start_and_the_solve_alone(tmp_path):
    """Neither the scene's start distribution nor how labels begin changes a path from rest at a given start."""
    times = expert_times(SCENE, EXPERT, STARTS[:2], INLINE, tmp_path)
    scene = SCENE.model_copy(update={"start": SCENE.start.model_copy(update={"std": (1.0, 1.0, 0.0, 0.0)})})
    expert = EXPERT.model_copy(update={"initial_velocity": "free"})
    again = expert_times(scene, expert, STARTS[1::-1], no_engine, tmp_path)
    np.testing.assert_array_equal(again.duration, times.duration[::-1])
    with pytest.raises(AssertionError, match="nothing is missing"):
        expert_times(SCENE, EXPERT.model_copy(update={"effort_weight": 6e-3}), STARTS[:2], no_engine, tmp_path)


def test_run_directories_side_by_side_time_equal_starts_once(tmp_path):
    with sharing(tmp_path / ".store"):
        one = expert_times(SCENE, EXPERT, STARTS[:2], INLINE, tmp_path / "one/evaluation/expert-times")
        other = expert_times(SCENE, EXPERT, STARTS[:2], no_engine, tmp_path / "two/evaluation/expert-times")
    np.testing.assert_array_equal(one.duration, other.duration)
    np.testing.assert_array_equal(one.arrival, other.arrival)


def test_what_one_has_made_another_copies(tmp_path):
    with sharing(tmp_path / "store"):
        one = do(tmp_path / "one")
        other = do(tmp_path / "other", engine=no_engine)
        assert part_bytes(tmp_path / "one") == part_bytes(tmp_path / "other")
        assert other.notes == one.notes
        grown = do(tmp_path / "grown", 11)
        assert ASKED == [9, 10]
        assert grown.notes["part-00002.npz"]["numbers"] == [8, 9, 10]
        assert len(part_bytes(tmp_path / "one")["part-00002.npz"]) != 0
        do(tmp_path / "fewer", 9, engine=no_engine)  # from the part of eleven
        assert part_bytes(tmp_path / "fewer") == part_bytes(tmp_path / "one")
        do(tmp_path / "of another key", key="other")
        assert len(ASKED) == 9
    do(tmp_path / "alone")
    assert len(ASKED) == 9


@pytest.mark.parametrize("damage", ["part", "half published", "of another"])
def test_a_damaged_shared_part_is_made_again_and_mended(tmp_path, damage):
    with sharing(tmp_path / "store"):
        one = do(tmp_path / "one")
        home = next((tmp_path / "store/squares").iterdir())
        path = home / "part-00001.npz"
        if damage == "part":
            data = bytearray(path.read_bytes())
            data[len(data) // 2] ^= 4
            path.write_bytes(data)
        elif damage == "half published":
            path.with_suffix(".json").unlink()
        else:
            path.write_bytes((home / "part-00000.npz").read_bytes())
        other = do(tmp_path / "other")
        assert ASKED == [4, 5, 6, 7]
        assert other.digest() == one.digest()
        do(tmp_path / "third", engine=no_engine)


PUBLISHER = """
import pathlib, sys
from agile_jax.store.shared import publish
who = int(sys.argv[2])
for items in range(1, 60):
    publish(pathlib.Path(sys.argv[1]), bytes([who]) * items * 1000, items, {"who": who, "items": items})
"""


def test_what_is_taken_while_two_processes_publish_is_whole_and_of_one(tmp_path):
    path, seen = tmp_path / "part-00000.npz", 0
    command = [sys.executable, "-c", PUBLISHER, str(path)]
    publishers = [subprocess.Popen([*command, who]) for who in ("1", "2")]
    while any(publisher.poll() is None for publisher in publishers):
        if (taken := take(path)) is not None:
            data, note = taken
            assert data[:1] * note["items"] * 1000 == data
            assert data[0] in (1, 2)
            seen += 1
    assert [publisher.returncode for publisher in publishers] == [0, 0]
    assert seen > 0
    publish(path, b"3" * 100, 100, {"who": 3})  # whatever they left is mended
    assert take(path) == (b"3" * 100, {"who": 3})
