"""The engine: same results everywhere, failures named, dead workers replaced, workers without JAX."""

import ctypes
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from agile_jax.engine import TaskFailure, open_engine
from agile_jax.settings import BadInput


def square(x):
    return x * x


def refuse_three(x):
    if x == 3:
        raise ValueError("three is\nnot allowed")
    return x


def loaded_modules(_):
    import agile_jax.dataset
    import agile_jax.expert  # noqa: F401

    return [name for name in ("jax", "jaxlib", "mujoco", "flax") if name in sys.modules]


def thread_settings(_):
    return os.environ.get("OMP_NUM_THREADS"), os.environ.get("OPENBLAS_NUM_THREADS")


def cores_of_all_threads(_):
    time.sleep(0.3)  # so that each worker gets a task
    threads = os.listdir("/proc/self/task")
    return os.getpid(), {core for thread in threads for core in os.sched_getaffinity(int(thread))}


def die_once(task):
    index, folder = task
    marker = pathlib.Path(folder) / "died"
    if index == 2 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return index


def sleep_when_asked(task):
    index, seconds = task
    time.sleep(seconds)
    return index


def hang_once(task):
    index, folder = task
    marker = pathlib.Path(folder) / "hung"
    if index == 0 and not marker.exists():
        marker.touch()
        hang_in_native_code()
    return index


def hang_in_native_code():
    """Keep the interpreter's lock for ever, so that neither a signal handler nor another thread gets to run."""
    ctypes.PyDLL(None).sleep(10_000)


def always_die(index):
    if index == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return index


def kill_if_first(index):
    if index == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.5)  # long enough to be there when the other worker dies
    return index


@pytest.fixture(scope="module")
def local():
    with open_engine("local", workers=2) as engine:
        yield engine


def test_inline_and_local_give_the_same(local):
    with open_engine("inline") as inline:
        assert list(inline.map(square, range(10))) == [(i, i * i) for i in range(10)]
    assert sorted(local.map(square, range(10))) == [(i, i * i) for i in range(10)]
    assert local.workers == 2
    assert list(local.map(square, [])) == []


def test_exceptions_become_failures(local):
    with open_engine("inline") as inline:
        for engine in (inline, local):
            results = dict(engine.map(refuse_three, range(6)))
            assert results.pop(3) == TaskFailure(3, "ValueError: three is not allowed")
            assert results == {i: i for i in (0, 1, 2, 4, 5)}


def test_workers_load_no_jax_and_run_one_thread(local):
    assert dict(local.map(loaded_modules, range(4))) == {i: [] for i in range(4)}
    assert set(dict(local.map(thread_settings, range(2))).values()) == {("1", "1")}


def test_remote_scheduler(local):
    address = local._client.scheduler.address
    with open_engine(address) as remote:
        assert remote.workers == 2
        assert sorted(remote.map(square, range(4))) == [(i, i * i) for i in range(4)]


def test_worker_killed_once_costs_nothing(local, tmp_path):
    assert sorted(local.map(die_once, [(i, str(tmp_path)) for i in range(5)])) == [(i, i) for i in range(5)]
    assert (tmp_path / "died").exists()


def test_neighbours_of_a_task_that_kills_its_worker_are_finished(local):
    """Also the one that shares the last worker with it while the other is replaced."""
    results = dict(local.map(kill_if_first, range(8)))
    assert isinstance(results.pop(0), TaskFailure)
    assert results == {i: i for i in range(1, 8)}


def test_task_that_always_kills_its_worker_fails_alone(local):
    results = dict(local.map(always_die, range(5)))
    failure = results.pop(1)
    assert isinstance(failure, TaskFailure)
    assert failure.index == 1
    assert "KilledWorker" in failure.cause
    assert results == {i: i for i in (0, 2, 3, 4)}


def test_a_worker_that_nobody_replaces_is_replaced():
    """Its nanny has gone, too, as it does when a worker dies while it starts."""
    with open_engine("local", workers=1) as engine:
        cluster = engine._client.cluster
        cluster.sync(cluster.workers[0].close)
        assert dict(engine.map(square, range(2))) == {0: 0, 1: 1}


def test_hung_task_is_cut_off_and_fails_alone(local):
    began = time.monotonic()
    tasks = [(i, 1000 if i == 1 else 0.1) for i in range(5)]
    results = dict(local.map(sleep_when_asked, tasks, time_limit_s=2))
    assert results.pop(1) == TaskFailure(1, "cut off after 2 s, 2 times")
    assert results == {i: i for i in (0, 2, 3, 4)}
    assert time.monotonic() - began < 60
    assert sorted(local.map(square, range(4))) == [(i, i * i) for i in range(4)]  # its worker was replaced


def test_task_that_hangs_once_with_the_interpreter_locked_costs_nothing(local, tmp_path):
    results = local.map(hang_once, [(i, str(tmp_path)) for i in range(4)], time_limit_s=2)
    assert sorted(results) == [(i, i) for i in range(4)]
    assert (tmp_path / "hung").exists()


def test_time_limit_is_of_each_task_not_of_their_queue(local):
    tasks = [(i, 0.7) for i in range(10)]  # 3.5 s in all on two workers
    assert sorted(local.map(sleep_when_asked, tasks, time_limit_s=2.5)) == [(i, i) for i in range(10)]


@pytest.mark.parametrize("address", ["nowhere", "http://x", "tcp://127.0.0.1:1"])
def test_bad_addresses_are_refused(address):
    with pytest.raises(BadInput, match="engine address"), open_engine(address):
        pass


def test_no_workers_is_refused():
    with pytest.raises(BadInput, match="at least 1"), open_engine("local", workers=0):
        pass


# Processes that a shell has put into the background ignore SIGINT, and so would the driver.
SCRIPT = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
from agile_jax.engine import open_engine

def slow(i):
    os.write(1, f"worker {os.getpid()}\\n".encode())  # in one piece: two workers share the pipe
    time.sleep(60)

if __name__ == "__main__":
    with open_engine("local", workers=2) as engine:
        list(engine.map(slow, range(2)))
"""


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_interrupted_or_killed_driver_leaves_no_process(tmp_path, sent):
    script = tmp_path / "driver.py"
    script.write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    workers = [int(process.stdout.readline().split()[1]) for _ in range(2)]
    if sent == signal.SIGINT:
        os.killpg(process.pid, sent)  # as a terminal does
    else:
        process.kill()
    process.wait(30)
    deadline = time.monotonic() + 20
    while any(map(alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(map(alive, workers))


def alive(pid):
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_the_environment_of_this_process_is_kept() -> None:
    before = dict(os.environ)
    with open_engine("local", workers=1) as engine:
        assert list(engine.map(thread_settings, [0])) == [(0, ("1", "1"))]
    assert dict(os.environ) == before


def test_nothing_is_logged_although_a_library_has_set_up_logging() -> None:
    program = (
        "import logging\nlogging.basicConfig()\nfrom agile_jax.engine import open_engine\n"
        "if __name__ == '__main__':\n    with open_engine('local', 1) as engine:\n"
        "        print(list(engine.map(abs, [-1])))"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert ended.stdout == "[(0, 1)]\n"
    assert ended.stderr == ""


def test_as_many_workers_as_cores_have_a_core_each():
    ours = os.sched_getaffinity(0)
    with open_engine("local") as engine:
        found = dict(result for _, result in engine.map(cores_of_all_threads, range(2 * len(ours))))
    assert all(len(cores) == 1 for cores in found.values())
    assert set().union(*found.values()) == ours
    with open_engine("local", workers=len(ours) + 1) as engine:
        assert next(engine.map(cores_of_all_threads, [0]))[1][1] == ours
    assert os.sched_getaffinity(0) == ours


UNGUARDED = """
from agile_jax.engine import open_engine

def cube(x):
    return x**3

with open_engine("local", workers=1) as engine:
    print(sorted(engine.map(cube, [1, 2])))
"""


@pytest.mark.parametrize("by", ["file", "standard input"])
def test_a_script_needs_no_main_guard_and_no_file(by, tmp_path):
    (tmp_path / "script.py").write_text(UNGUARDED)
    arguments = [sys.executable, str(tmp_path / "script.py")] if by == "file" else [sys.executable]
    given = UNGUARDED if by == "standard input" else ""
    ended = subprocess.run(arguments, input=given, capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stdout) == (0, "[(0, 1), (1, 8)]\n"), ended.stderr
