"""The work engine: maps a module-level function over independent tasks, here, over local processes or over a cluster.

A task that raises, or whose worker dies again and again, becomes a `TaskFailure`; all others are finished. A worker
that dies once costs nothing: it is replaced and its task runs again, so tasks must be idempotent. Local workers are
spawned processes of one thread each, on the loopback interface; they hold no accelerator because nothing that they
import loads JAX.
"""

import logging
import os
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol

from agile_jax.settings import BadInput

# One thread a worker: numerical libraries that start their own would fight over the cores, and could change last
# digits.
THREADS = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")}
ALLOWED_DEATHS = 2  # of workers under one task, before the task is given up


class TaskFailure(NamedTuple):
    """A task without result."""

    index: int  # type: ignore[assignment]  # hides tuple.index, which nobody needs here
    cause: str


class Engine(Protocol):
    """Where tasks run."""

    workers: int

    def map(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield (index, result or `TaskFailure`) in order of completion, once for every task."""
        ...


class InlineEngine:
    """Runs tasks in this process, in order: for debugging, and for very little work."""

    workers = 1

    def map(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """See `Engine.map`."""
        for index, task in enumerate(tasks):
            try:
                result = function(task)
            except Exception as error:
                result = TaskFailure(index, describe(error))
            yield index, result


class DaskEngine:
    """Runs tasks through a dask.distributed client."""

    def __init__(self, client: Any):
        self._client = client
        self.workers = max(1, sum(client.nthreads().values()))

    def map(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """See `Engine.map`.

        No more tasks are in flight than there are workers, so that one that kills its worker takes no waiting neighbour
            with it. While a dead worker is replaced, two tasks may share one all the same: whatever was under workers
            that died too often is tried once more at the end, alone.
        """
        suspects: list[tuple[int, Any]] = []
        for index, future in self._completed(function, list(enumerate(tasks)), self.workers):
            if future.status == "error" and type(future.exception()).__name__ == "KilledWorker":
                suspects.append((index, tasks[index]))
            else:
                yield index, _outcome(index, future)
        for index, future in self._completed(function, suspects, 1):
            yield index, _outcome(index, future)

    def _completed(
        self, function: Callable[[Any], Any], tasks: list[tuple[int, Any]], at_once: int
    ) -> Iterator[tuple[int, Any]]:
        """Yield (index, ended future), with at most `at_once` in flight."""
        from distributed import as_completed

        waiting = tasks[::-1]
        running: dict[Any, int] = {}
        completed = as_completed(raise_errors=False)

        def submit() -> None:
            index, task = waiting.pop()
            # pure=False: equal tasks are different tasks; the key must not depend on hashing the settings.
            future = self._client.submit(function, task, pure=False)
            running[future] = index
            completed.add(future)

        while waiting and len(running) < at_once:
            submit()
        while running:
            future = next(completed)
            index = running.pop(future)
            if waiting:
                submit()
            yield index, future


def _outcome(index: int, future: Any) -> Any:
    """The result of an ended future, or its failure."""
    if future.status == "finished":
        return future.result()
    cause = describe(future.exception()) if future.status == "error" else f"the task was {future.status}"
    return TaskFailure(index, cause)


def describe(error: BaseException) -> str:
    """One line about an exception."""
    if type(error).__name__ == "KilledWorker":
        return (
            f"KilledWorker: the task's worker process died {ALLOWED_DEATHS + 1} times "
            "(out of memory, or a crash in native code)"
        )
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


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
        BadInput: unknown address, or no scheduler answers there.
    """
    check_engine(address, workers)
    if address == "inline":
        yield InlineEngine()
    elif address == "local":
        with _local_client(workers or len(os.sched_getaffinity(0))) as client:
            yield DaskEngine(client)
    else:
        with _remote_client(address) as client:
            yield DaskEngine(client)


@contextmanager
def _local_client(workers: int) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    quiet = {"distributed.scheduler.allowed-failures": ALLOWED_DEATHS, "distributed.admin.tick.limit": "1h"}
    with (
        _quiet_loggers(),
        _environment_kept(),
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
        client.register_plugin(_ignore_interrupts())
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


def _ignore_interrupts() -> Any:
    """Ctrl-C reaches every process of the terminal; only this one should act on it, and then close the workers."""
    from distributed import WorkerPlugin

    class IgnoreInterrupts(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return IgnoreInterrupts()


@contextmanager
def _remote_client(address: str) -> Iterator[Any]:
    from distributed import Client

    try:
        client = Client(address, timeout="4s")
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(f"engine address {address}: no dask scheduler answers ({describe(error)})") from None
    with client:
        if not client.nthreads():
            raise BadInput(f"engine address {address}: the scheduler has no workers")
        yield client
