"""What an engine is, the simplest one, and the failure of a task."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol, TypeVar, runtime_checkable

Task = TypeVar("Task")
Made = TypeVar("Made")


class TaskFailure(NamedTuple):
    """A task without result."""

    index: int  # type: ignore[assignment]  # hides tuple.index, which nobody needs here
    cause: str


class TasksFailedError(RuntimeError):
    """Some tasks failed for good; what the others made is kept. The text names them."""


@runtime_checkable
class Engine(Protocol):
    """Where tasks run."""

    workers: int

    def map(
        self, function: Callable[[Task], Made], tasks: Sequence[Task], time_limit_s: float | None = None
    ) -> Iterator[tuple[int, Made | TaskFailure]]:
        """Yield (index, result or `TaskFailure`) in order of completion, once for every task.

        Args:
            function: of a module, so that other processes can find it.
            tasks: its arguments, which can be pickled.
            time_limit_s: of one try at one task [s]; a worker that exceeds it is killed and replaced. None sets no
                limit.
        """
        ...


class InlineEngine:
    """Runs tasks in this process, in order: for debugging, and for very little work."""

    workers = 1

    def map(
        self, function: Callable[[Task], Made], tasks: Sequence[Task], time_limit_s: float | None = None
    ) -> Iterator[tuple[int, Made | TaskFailure]]:
        """See `Engine.map`. Nobody stands by who could kill this process, so the time limit is not enforced."""
        del time_limit_s
        for index, task in enumerate(tasks):
            try:
                result: Made | TaskFailure = function(task)
            except Exception as error:
                result = TaskFailure(index, describe(error))
            yield index, result


def describe(error: BaseException) -> str:
    """One line about an exception."""
    if type(error).__name__ == "KilledWorker":
        return "KilledWorker: the task's worker process died every time (out of memory, or a crash in native code)"
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
