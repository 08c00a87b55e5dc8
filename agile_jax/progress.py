"""Progress of long work: a bar with the time left on a terminal, now and then a plain line elsewhere.

Long functions take `progress: Progress` and know nothing of how it is shown.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TextIO, runtime_checkable

LINE_PERIOD = 10.0  # seconds between plain lines


@runtime_checkable
class Progress(Protocol):
    """What a long function tells of its work."""

    def __call__(self, work: str, done: int, total: int, note: str = "") -> None:
        """Tell how far the work has come.

        Args:
            work: names it, for example "trajectories": each work has a bar, a clock and a rate of its own.
            done: number of its parts that are finished.
            total: number of its parts; 0 when nobody knows.
            note: what may change while the work goes on, for example "validation error 1.2e-03".
        """
        ...


def silent(work: str, done: int, total: int, note: str = "") -> None:
    """Show nothing."""
    del work, done, total, note


def within(name: str, progress: Progress) -> Progress:
    """`progress` for a part of a whole: "trajectories" within "dataset" is the work "dataset: trajectories"."""

    def named(work: str, done: int, total: int, note: str = "") -> None:
        progress(f"{name}: {work}", done, total, note)

    return named


@contextmanager
def shown(stream: TextIO | None = None) -> Iterator[Progress]:
    """Progress that shows on `stream` (standard error): a bar for each work on a terminal, else plain lines."""
    stream = stream or sys.stderr
    if stream.isatty():
        with _bar(stream) as progress:
            yield progress
    else:
        yield plain_lines(stream)


def plain_lines(stream: TextIO, period: float = LINE_PERIOD, clock: Callable[[], float] = time.monotonic) -> Progress:
    """Lines such as `dataset: trajectories 100/400 (25 %), 12 s left`: each work's first and last, else one a period.

    Args:
        stream: where they are printed.
        period: of the lines between the first and the last [s].
        clock: tells the time [s].
    """
    began: dict[str, tuple[float, int]] = {}
    last: dict[str, float] = {}

    def progress(work: str, done: int, total: int, note: str = "") -> None:
        now = clock()
        start, first = began.setdefault(work, (now, done))
        finished = 0 < total <= done
        if work in last and not finished and now - last[work] < period:
            return
        last[work] = now
        text = _text(work, note)
        if total > 0:
            text += f" {done}/{total} ({100 * done // total} %)"
            if first < done < total:
                text += f", {duration((now - start) * (total - done) / (done - first))} left"
        try:
            print(text, file=stream, flush=True)
        except BrokenPipeError:  # the reader has gone (`| head`); the work goes on
            return

    return progress


@contextmanager
def _bar(stream: TextIO) -> Iterator[Progress]:
    from rich import progress as rich
    from rich.console import Console
    from rich.markup import escape

    columns = (
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.MofNCompleteColumn(),
        rich.TimeElapsedColumn(),
        rich.TimeRemainingColumn(),
    )
    with rich.Progress(*columns, console=Console(file=stream)) as bars:
        tasks: dict[str, rich.TaskID] = {}

        def progress(work: str, done: int, total: int, note: str = "") -> None:
            description = escape(_text(work, note))
            if work not in tasks:
                tasks[work] = bars.add_task(description, total=None)
            bars.update(tasks[work], completed=done, total=total or None, description=description)

        yield progress


def _text(work: str, note: str) -> str:
    return f"{work}, {note}" if note else work


def duration(seconds: float) -> str:
    """A duration to read: 42 s, 3 min 05 s, 2 h 07 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
