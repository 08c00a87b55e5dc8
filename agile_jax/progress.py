"""Progress of long work: a bar with the time left on a terminal, now and then a plain line elsewhere.

Long functions take `progress`, a callable of (done, total, note). They know nothing of how it is shown.
"""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

Progress = Callable[[int, int, str], None]

LINE_PERIOD = 10.0  # seconds between plain lines


def silent(done: int, total: int, note: str) -> None:
    """Show nothing."""
    del done, total, note


@contextmanager
def shown(stream: TextIO | None = None) -> Iterator[Progress]:
    """A progress callable that shows on `stream` (standard error): a bar on a terminal, else plain lines.

    A note's text up to its first colon names the work: when it changes, a new bar or line begins.
    """
    stream = stream or sys.stderr
    if stream.isatty():
        with _bar(stream) as progress:
            yield progress
    else:
        yield plain_lines(stream)


def plain_lines(stream: TextIO, period: float = LINE_PERIOD, clock: Callable[[], float] = time.monotonic) -> Progress:
    """Lines such as `dataset: 100/400 (25 %), 12 s left`: each work's first and last, else one in `period` seconds."""
    began: dict[str, tuple[float, int]] = {}
    last: dict[str, float] = {}

    def progress(done: int, total: int, note: str) -> None:
        now, work = clock(), _work(note)
        start, first = began.setdefault(work, (now, done))
        finished = 0 < total <= done
        if work in last and not finished and now - last[work] < period:
            return
        last[work] = now
        text = note
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

    columns = (
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.MofNCompleteColumn(),
        rich.TimeElapsedColumn(),
        rich.TimeRemainingColumn(),
    )
    with rich.Progress(*columns, console=Console(file=stream)) as bars:
        tasks: dict[str, rich.TaskID] = {}

        def progress(done: int, total: int, note: str) -> None:
            work = _work(note)
            if work not in tasks:
                tasks[work] = bars.add_task(note, total=None)
            bars.update(tasks[work], completed=done, total=total or None, description=note)

        yield progress


def _work(note: str) -> str:
    """What a note is about."""
    name, colon, _ = note.partition(":")
    return name if colon else ""


def duration(seconds: float) -> str:
    """A duration to read: 42 s, 3 min 05 s, 2 h 07 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
