"""Tasks through a dask.distributed client, with the watchdog that Dask has not: it cuts off a task that hangs.

Dask replaces workers that die, and gives a task up when too many have died under it; but nothing ends a native solver
that does not return. The driver therefore asks the scheduler every second what runs where, and has a worker that
exceeds the time limit killed by its nanny, which needs no cooperation of the process that hangs.
"""

import contextlib
import logging
import os
import queue
import signal
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import TYPE_CHECKING, Generic, NamedTuple, Protocol

from agile_jax import plugins
from agile_jax.engine.tasks import Made, Task, TaskFailure, describe

if TYPE_CHECKING:
    from distributed import Client, Future

TRIES = 2  # at a task that exceeds the time limit
PERIOD_S = 1.0  # between two looks at the workers
PATIENCE_S = 120.0  # with a cluster that has no worker at all
LOST = "the connection to the scheduler was lost"

logger = logging.getLogger(__name__)


class Flight(NamedTuple, Generic[Task]):
    """A task that the scheduler has."""

    position: int
    task: Task
    future: "Future"


class DaskEngine:
    """Runs tasks through a dask.distributed client whose workers have one thread each."""

    def __init__(self, client: "Client", replenish: Callable[[], None] | None = None) -> None:
        """Use a client.

        Args:
            client: of the cluster.
            replenish: called while there are fewer workers than at the beginning; a nanny replaces its worker unless
                that dies while it starts.
        """
        self._client = client
        self._replenish = replenish
        self._wanted = self.workers = max(1, len(client.nthreads()))

    def map(
        self, function: Callable[[Task], Made], tasks: Sequence[Task], time_limit_s: float | None = None
    ) -> Iterator[tuple[int, Made | TaskFailure]]:
        """See `Engine.map`.

        No more tasks are in flight than there are workers, so that one that kills its worker takes no waiting neighbour
        with it. While a dead worker is replaced, two tasks may share one all the same: whatever was under workers
        that died too often is tried once more at the end, alone. Workers that join the cluster later are used, too.
        """
        waiting = list(enumerate(tasks))[::-1]
        flights: dict[str, Flight[Task]] = {}
        landed: queue.SimpleQueue[str] = queue.SimpleQueue()
        times_cut_off: Counter[int] = Counter()
        watch = Watch(self._client)
        suspects: list[tuple[int, Task]] = []  # that were under workers which died too often
        alone = False  # whether the suspects are running
        end = ""  # why the rest can only fail

        while (waiting or flights or suspects) and not end:
            if not waiting and not flights:
                waiting, suspects, alone = suspects[::-1], [], True
            while waiting and len(flights) < (1 if alone else self.workers):
                position, task = waiting.pop()
                # pure=False: equal tasks are different tasks; the key must not depend on hashing the settings.
                shipped = plugins.ship(function, task)
                what = (function, task) if shipped is None else (plugins.unpack, shipped)
                future = self._client.submit(*what, pure=False)
                flights[future.key] = Flight(position, task, future)
                future.add_done_callback(lambda future: landed.put(future.key))
            with contextlib.suppress(queue.Empty):
                flight = flights.pop(landed.get(timeout=PERIOD_S), None)
                if flight is not None and not alone and _killed_its_worker(flight.future):
                    suspects.append((flight.position, flight.task))
                elif flight is not None:  # None: it was cut off
                    failure = _failure(flight)
                    if failure is not None and flight.future.status != "error":
                        end = LOST
                    yield flight.position, failure or flight.future.result()
                del flight

            if end or not watch.look(flights):
                continue
            self.workers = max(1, watch.workers)
            if self._replenish is not None and watch.workers < self._wanted:
                self._replenish()
            if watch.deserted_s > PATIENCE_S:
                end = f"the cluster has had no worker for {PATIENCE_S:g} s"
            for key, worker in watch.overdue(time_limit_s):
                position, task, future = flights.pop(key)
                times_cut_off[position] += 1
                logger.warning("task %d exceeds %g s on %s, which is replaced", position, time_limit_s, worker)
                future.cancel()
                # Not Client.restart_workers: a worker that closes politely may take its nanny with it.
                self._client.run(_kill_process, workers=[worker], nanny=True, on_error="ignore")
                if times_cut_off[position] < TRIES:
                    waiting.insert(0, (position, task))  # after all others
                else:
                    yield position, TaskFailure(position, f"cut off after {time_limit_s:g} s, {TRIES} times")

        for position in sorted(
            [flight.position for flight in flights.values()] + [position for position, _ in waiting + suspects]
        ):
            yield position, TaskFailure(position, end)


def _killed_its_worker(future: "Future") -> bool:
    """Whether Dask gave the task up because workers died under it."""
    return future.status == "error" and type(future.exception()).__name__ == "KilledWorker"


def _failure(flight: Flight[Task]) -> TaskFailure | None:
    """Why a task that has ended has no result; None where it has one."""
    if flight.future.status == "finished":
        return None
    if flight.future.status == "error":
        return TaskFailure(flight.position, describe(flight.future.exception()))
    return TaskFailure(flight.position, LOST)


class Nanny(Protocol):
    """What is asked of the process that stands by a worker."""

    pid: int  # of the worker


def _kill_process(dask_worker: Nanny) -> None:
    """Kill the worker of the nanny that this runs in; a nanny starts a new one when its worker dies."""
    os.kill(dask_worker.pid, signal.SIGKILL)


class Watch:
    """What runs on which worker, and since when."""

    def __init__(self, client: "Client"):
        self._client = client
        self._since: dict[str, tuple[str, float]] = {}  # by key: worker, time
        self._looked = self._inhabited = time.monotonic()
        self.workers = 0
        self.deserted_s = 0.0  # how long there has been no worker

    def look(self, keys: Collection[str]) -> bool:
        """Ask the scheduler about the tasks with these keys. Returns whether it was time to, and it answered."""
        now = time.monotonic()
        if now < self._looked + PERIOD_S:
            return False
        self._looked = now
        try:
            processing = self._client.processing()
        except (OSError, TimeoutError):
            return False  # the client notices by itself when the scheduler has gone
        self.workers = len(processing)
        if processing:
            self._inhabited = now
        self.deserted_s = now - self._inhabited
        # A worker of one thread runs the first of its tasks; others wait there after a neighbour's death.
        at = {tasks[0]: worker for worker, tasks in processing.items() if tasks}
        before, self._since = self._since, {}
        for key in keys:
            if key in at:
                known = before.get(key)
                self._since[key] = known if known and known[0] == at[key] else (at[key], now)
        return True

    def overdue(self, time_limit_s: float | None) -> list[tuple[str, str]]:
        """(key, worker) of what runs for longer than the limit."""
        if time_limit_s is None:
            return []
        return [(key, at) for key, (at, since) in self._since.items() if self._looked - since > time_limit_s]
