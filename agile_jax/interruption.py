"""Ctrl-C and SIGTERM as exceptions that are not lost.

An exception raised by a signal handler disappears when the signal arrives inside a garbage collector's callback or a
destructor; libraries that we use have such callbacks. So the signal is also remembered, and raised again at the next
report of progress, which every long function makes. Only programs install this, never an import.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from agile_jax.progress import Progress, shown


class Interrupted(BaseException):
    """SIGINT or SIGTERM arrived. Not an Exception, so that no stage takes it for a failure of its own."""

    def __init__(self, number: int):
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def interruptible() -> Iterator[list[int]]:
    """Raise `Interrupted` on SIGINT and SIGTERM inside; a second one ends the process at once.

    Yields:
        The signals that have arrived, for `persistent`.
    """
    arrived: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        del frame
        arrived.append(number)
        signal.signal(number, signal.SIG_DFL)
        raise Interrupted(number)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield arrived
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def persistent(progress: Progress, arrived: list[int]) -> Progress:
    """`progress` that raises `Interrupted` again when a signal has arrived and its exception was lost."""

    def checked(work: str, done: int, total: int, note: str = "") -> None:
        if arrived:
            raise Interrupted(arrived[0])
        progress(work, done, total, note)

    return checked


@contextmanager
def interruptible_progress() -> Iterator[Progress]:
    """Progress on standard error; SIGINT and SIGTERM raise `Interrupted` inside."""
    with interruptible() as arrived, shown() as progress:
        yield persistent(progress, arrived)
