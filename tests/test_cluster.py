"""The engine on a cluster: a scheduler and two workers started by themselves, as docs/cluster.md says."""

import os
import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from agile_jax.engine import TaskFailure, dask_engine, open_engine
from agile_jax.settings import BadInput

ROOT = pathlib.Path(__file__).parents[1]
BASE = ROOT / "experiments" / "base.toml"
SMALL = ["--dataset.trajectories", "6", "--dataset.shard-size", "2", "--expert.nodes", "20"]


class Cluster:
    """`dask scheduler` and `dask worker` processes."""

    def __init__(self, folder: pathlib.Path):
        self.folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        self.address = self.wait_for_line("0.log", "Scheduler at:").split()[-1]

    def start(self, *arguments: str, first_path: str = "") -> subprocess.Popen[bytes]:
        path = os.pathsep.join([first_path, str(pathlib.Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        with (self.folder / f"{len(self.processes)}.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments],
                stdout=log,
                stderr=log,
                cwd=self.folder,
                env=os.environ | {"PYTHONPATH": path},  # the functions below are of this module
            )
        self.processes.append(process)
        return process

    def start_worker(self, *options: str, first_path: str = "") -> subprocess.Popen[bytes]:
        """Start one worker and wait until it is registered."""
        options = options or ("--nthreads", "1")
        name = f"{len(self.processes)}.log"
        place = ["--no-dashboard", "--host", "127.0.0.1", "--local-directory", str(self.folder)]
        process = self.start("worker", self.address, *place, *options, first_path=first_path)
        self.wait_for_line(name, "Registered to:")
        return process

    def wait_for_line(self, name: str, words: str) -> str:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            for line in (self.folder / name).read_text().splitlines():
                if words in line:
                    return line
            time.sleep(0.1)
        raise AssertionError((self.folder / name).read_text())

    def stop(self) -> None:
        for process in self.processes[::-1]:  # the scheduler last: workers would try to find it again
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.fixture
def bare_cluster(tmp_path: pathlib.Path) -> Iterator[Cluster]:
    """A scheduler without workers."""
    (tmp_path / "cluster").mkdir()
    cluster = Cluster(tmp_path / "cluster")
    yield cluster
    cluster.stop()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler and two workers."""
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    cluster.start_worker()
    cluster.start_worker()
    yield cluster
    cluster.stop()


def double(x: int) -> int:
    return 2 * x


def sleep(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def kill_when_asked(task: int) -> int:
    if task == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def agile(*arguments: str, folder: pathlib.Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "agile_jax.cli", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


def shards(run_dir: pathlib.Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((run_dir / "dataset").glob("shard-*.npz"))}


def test_cluster_writes_the_same_bytes_as_this_process(cluster: Cluster, tmp_path: pathlib.Path) -> None:
    (tmp_path / "e.toml").write_text(f'extends = "{BASE}"\nname = "n"\n')
    for name, engine in (("one/inline", "inline"), ("other/cluster", cluster.address)):
        done = agile("expert", "e.toml", *SMALL, "--engine", engine, "--run-dir", name, folder=tmp_path)
        assert done.returncode == 0, done.stderr
    assert len(shards(tmp_path / "one/inline")) == 3
    assert shards(tmp_path / "other/cluster") == shards(tmp_path / "one/inline")
    assert '"workers": 2' in (tmp_path / "other/cluster/dataset/summary.json").read_text()


def test_both_workers_work_and_killed_and_hung_ones_are_replaced(cluster: Cluster) -> None:
    with open_engine(cluster.address) as engine:
        assert engine.workers == 2
        assert len(set(dict(engine.map(sleep, [0.5] * 4)).values())) == 2
        results = dict(engine.map(kill_when_asked, range(4)))
        assert isinstance(failure := results.pop(1), TaskFailure)
        assert "KilledWorker" in failure.cause
        assert results == {0: 0, 2: 2, 3: 3}
        results = dict(engine.map(sleep, [0.1, 1000, 0.1], time_limit_s=2))
        assert results[1] == TaskFailure(1, "cut off after 2 s, 2 times")
        assert not isinstance(results[0], TaskFailure)
        assert not isinstance(results[2], TaskFailure)
    with open_engine(cluster.address) as engine:  # the cluster outlives its clients and their failures
        assert sorted(engine.map(double, range(4))) == [(i, 2 * i) for i in range(4)]


@pytest.mark.slow
def test_workers_that_cannot_be_used_are_refused_and_late_ones_used(
    bare_cluster: Cluster, tmp_path: pathlib.Path
) -> None:
    with pytest.raises(BadInput, match="the scheduler has no workers"), open_engine(bare_cluster.address):
        pass
    other = tmp_path / "other" / "casadi-3.0.0.dist-info"  # found before the one that is installed
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: casadi\nVersion: 3.0.0\n")
    useless = bare_cluster.start_worker("--nthreads", "3", "--no-nanny", first_path=str(other.parent))
    with pytest.raises(BadInput, match=r"has 3 threads") as caught, open_engine(bare_cluster.address):
        pass
    assert "has no nanny" in str(caught.value)
    assert "has casadi 3.0.0, here it is" in str(caught.value)
    useless.send_signal(signal.SIGINT)
    useless.wait(30)

    bare_cluster.start_worker()
    with open_engine(bare_cluster.address) as engine:
        assert engine.workers == 1
        results = engine.map(sleep, [0.3] * 12)
        next(results)
        bare_cluster.start_worker()
        assert len({pid for _, pid in results}) == 2


@pytest.mark.slow
def test_a_cluster_that_goes_away_ends_the_work_with_its_cause(
    bare_cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_engine, "PATIENCE_S", 3)
    worker = bare_cluster.start_worker()
    with open_engine(bare_cluster.address) as engine:
        results = engine.map(sleep, [0.3, 0.3, 0.3])
        next(results)
        worker.send_signal(signal.SIGINT)
        rest = dict(results)
        assert set(rest) == {1, 2}
        assert TaskFailure(2, "the cluster has had no worker for 3 s") in rest.values()

    bare_cluster.start_worker()
    with open_engine(bare_cluster.address) as engine:
        results = engine.map(sleep, [0.1, 1000, 0.1])
        next(results)
        bare_cluster.scheduler.kill()
        began = time.monotonic()
        assert sorted(results) == [(i, TaskFailure(i, "the connection to the scheduler was lost")) for i in (1, 2)]
        assert time.monotonic() - began < 30


def test_an_unreachable_scheduler_is_one_line_and_quick(tmp_path: pathlib.Path) -> None:
    (tmp_path / "e.toml").write_text(f'extends = "{BASE}"\nname = "n"\n')
    began = time.monotonic()
    done = agile("expert", "e.toml", *SMALL, "--engine", "tcp://127.0.0.1:1", folder=tmp_path)
    assert time.monotonic() - began < 20
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("agile: engine address tcp://127.0.0.1:1: no dask scheduler answers")
    assert "Traceback" not in done.stderr
    assert not shards(tmp_path / "runs/n")
