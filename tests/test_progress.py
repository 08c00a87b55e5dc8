"""What progress shows, and how often."""

import io

import pytest

from agile_jax.progress import duration, plain_lines, shown, within


def test_plain_lines_are_limited_and_tell_the_time_left() -> None:
    now = 0.0
    stream = io.StringIO()
    progress = within("dataset", plain_lines(stream, period=10.0, clock=lambda: now))
    for done in range(101):
        progress(done=done, total=100, work="trajectories")
        now += 1.0
    lines = stream.getvalue().splitlines()
    assert lines[0] == "dataset: trajectories 0/100 (0 %)"
    assert lines[1] == "dataset: trajectories 10/100 (10 %), 1 min 30 s left"
    assert lines[-1] == "dataset: trajectories 100/100 (100 %)"
    assert len(lines) == 11


def test_each_work_has_its_own_clock_and_resumed_work_its_own_rate() -> None:
    """What a note says, with a colon or without, changes no work."""
    now = 0.0
    stream = io.StringIO()
    progress = plain_lines(stream, period=5.0, clock=lambda: now)
    progress("a", 80, 100, "resumed")
    progress("b", 0, 0, "no total")
    progress("c", 0, 9, "0.1 s: simulated")
    progress("c", 0, 9, "0.2 s: simulated")
    now = 10.0
    progress("a", 90, 100, "resumed")
    assert stream.getvalue().splitlines() == [
        "a, resumed 80/100 (80 %)",
        "b, no total",
        "c, 0.1 s: simulated 0/9 (0 %)",
        "a, resumed 90/100 (90 %), 10 s left",  # ten in ten seconds, not ninety
    ]


def test_a_closed_reader_does_not_end_the_work() -> None:
    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    plain_lines(Closed())("work", 1, 2)


def test_a_terminal_gets_a_bar() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    with shown(stream) as progress:
        progress("dataset: trajectories", 1, 4, "[left]")
        progress("dataset: trajectories", 4, 4, "[left]")
    assert "dataset: trajectories, [left]" in stream.getvalue()
    assert "4/4" in stream.getvalue()


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (59.6, "1 min 00 s"), (3599, "59 min 59 s"), (7620, "2 h 07 min")]
)
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text
