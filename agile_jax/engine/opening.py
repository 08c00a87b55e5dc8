"""Opening an engine: here, in local processes on the loopback interface, or on a running cluster."""

import logging
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from multiprocessing import spawn
from typing import TYPE_CHECKING

from agile_jax.engine.dask_engine import DaskEngine
from agile_jax.engine.tasks import Engine, InlineEngine, describe
from agile_jax.settings import BadInput

if TYPE_CHECKING:
    from distributed import Client, Worker, WorkerPlugin

# One thread a worker: numerical libraries that start their own would fight over the cores, and could change last
# digits.
THREADS = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")}
ALLOWED_DEATHS = 2  # of workers under one task, before the task is given up
LOST_AFTER = "5s"  # without its worker a nanny is taken for dead: it ends with one that dies while it starts


def check_engine(address: str, workers: int | None) -> None:
    """Refuse what `open_engine` cannot understand (BadInput), without starting or asking anything."""
    if workers is not None and workers < 1:
        raise BadInput(f"engine workers = {workers} must be at least 1")
    if address not in ("local", "inline") and not address.startswith(("tcp://", "tls://")):
        raise BadInput(f'engine address "{address}" is none of "local", "inline", "tcp://host:port"')


@contextmanager
def open_engine(address: str = "local", workers: int | None = None) -> Iterator[Engine]:
    """Open an engine; leaving the context, also by Ctrl-C, ends its processes.

    Args:
        address: "local" for processes on this machine, "inline" for none, or "tcp://host:port" of a dask scheduler.
        workers: local processes; None takes one for each core that this process may use.

    Raises:
        BadInput: unknown address, no scheduler answers there, or its processes cannot be used.
    """
    check_engine(address, workers)
    if address == "inline":
        yield InlineEngine()
    elif address == "local":
        count = workers or len(os.sched_getaffinity(0))
        with _local_client(count) as client:
            yield DaskEngine(client, replenish=lambda: client.cluster.scale(count))
    else:
        with _remote_client(address) as client:
            yield DaskEngine(client)


@contextmanager
def _local_client(workers: int) -> Iterator["Client"]:
    import dask
    from distributed import Client, LocalCluster

    quiet = {
        "distributed.scheduler.allowed-failures": ALLOWED_DEATHS,
        "distributed.admin.tick.limit": "1h",
        "distributed.deploy.lost-worker-timeout": LOST_AFTER,
    }
    with (
        _quiet_loggers(),
        _environment_kept(),
        _without_main_script(),
        tempfile.TemporaryDirectory(prefix="agile-engine-", ignore_cleanup_errors=True) as scratch,
        dask.config.set(quiet),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",  # None would still take port 8787, and complain when it is taken
            silence_logs=logging.CRITICAL,
            memory_limit=0,
            local_directory=scratch,
            env=THREADS,
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(_preparation(workers))
        yield client


@contextmanager
def _quiet_loggers() -> Iterator[None]:
    """Silence distributed, which reports every connection to the root logger when a library has given that a handler.

    (`silence_logs` only reaches a handler of distributed's own, which it then does not make.)
    """
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.gc")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


@contextmanager
def _without_main_script() -> Iterator[None]:
    """Keep workers from running the main script once more, as spawned processes do.

    It may have no main guard, and then each worker would start workers, or no file (standard input). What workers do is
    in modules.
    """
    prepare = spawn.get_preparation_data

    def without_main_script(name: str) -> dict[str, object]:
        return {key: value for key, value in prepare(name).items() if not key.startswith("init_main")}

    spawn.get_preparation_data = without_main_script  # also for a worker that takes a dead one's place
    try:
        yield
    finally:
        spawn.get_preparation_data = prepare


@contextmanager
def _environment_kept() -> Iterator[None]:
    """Undo what is set inside: distributed puts the workers' numbers of threads into its own process, too.

    There they would reach the BLAS under JAX's linear algebra if it is loaded later, and change last digits of what
    this process computes after it has used an engine.
    """
    before = dict(os.environ)
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update(before)


def _preparation(workers: int) -> "WorkerPlugin":
    """What each of the workers does when it starts.

    It ignores Ctrl-C, which reaches every process of the terminal: only this one should act on it, and then close the
    workers. Where there is a core for each of them, it holds itself to one: JAX hands small pieces of work from thread
    to thread, and waking a thread on another core takes longer than they do. One process simulates 64 robots faster on
    one core than on two (docs/benchmark.md).
    """
    from distributed import WorkerPlugin

    cores = sorted(os.sched_getaffinity(0))

    class Preparation(WorkerPlugin):
        def setup(self, worker: "Worker") -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            if workers == len(cores):
                own = cores[int(worker.name) % len(cores)]
                for thread in os.listdir("/proc/self/task"):  # threads that are yet to come inherit it
                    os.sched_setaffinity(int(thread), {own})

    return Preparation()


@contextmanager
def _remote_client(address: str) -> Iterator["Client"]:
    from distributed import Client

    try:
        client = Client(address, timeout="4s")
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(f"engine address {address}: no dask scheduler answers ({describe(error)})") from None
    with client:
        _check_cluster(client, address)
        yield client


def software() -> dict[str, str]:
    """The versions that labels depend on, here."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    return {"python": python} | {name: version(name) for name in ("agile_jax", "casadi", "numpy")}


def _check_cluster(client: "Client", address: str) -> None:
    """Refuse a cluster (BadInput) on which tasks would fail, disturb each other or give other last digits."""
    workers = client.scheduler_info(n_workers=-1)["workers"]
    if not workers:
        raise BadInput(f"engine address {address}: the scheduler has no workers")
    problems = []
    for worker, about in workers.items():
        if about["nthreads"] != 1:
            problems.append(
                f"worker {worker} has {about['nthreads']} threads; the solvers are not thread-safe, "
                "start it with --nthreads 1"
            )
        if about["nanny"] is None:
            problems.append(f"worker {worker} has no nanny to replace it, start it without --no-nanny")
    here = software()
    everywhere = {f"worker {worker}": there for worker, there in client.run(software, on_error="return").items()}
    try:
        everywhere["the scheduler"] = client.run_on_scheduler(software)
    except Exception as error:
        everywhere["the scheduler"] = error
    for who, there in everywhere.items():
        if isinstance(there, OSError):
            continue  # it died a moment ago, and its nanny replaces it
        if isinstance(there, BaseException):
            problems.append(f"{who} cannot use agile_jax ({describe(there)})")
        else:
            differing = [name for name in here if there[name] != here[name]]
            problems += [f"{who} has {name} {there[name]}, here it is {here[name]}" for name in differing]
    if problems:
        raise BadInput("\n".join([f"engine address {address}: it cannot be used", *problems]))
