"""Signals as exceptions that are not lost."""

import gc
import os
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from agile_jax.interruption import Interrupted, interruptible, persistent
from agile_jax.progress import silent


@pytest.fixture(autouse=True)
def handlers_are_put_back() -> Iterator[None]:
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    yield
    assert [signal.getsignal(number) for number in numbers] == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_raises(number: signal.Signals) -> None:
    with pytest.raises(Interrupted) as caught, interruptible():
        os.kill(os.getpid(), number)
    assert caught.value.number == number


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_exception_lost_in_the_garbage_collector_comes_again_with_the_next_progress() -> None:
    def callback(phase: str, info: dict[str, Any]) -> None:
        if phase == "start" and not sent:
            sent.append(True)
            os.kill(os.getpid(), signal.SIGTERM)

    sent: list[bool] = []
    with interruptible() as arrived:
        progress = persistent(silent, arrived)
        progress("before", 0, 2)
        gc.callbacks.append(callback)
        try:
            gc.collect()  # swallows the exception
        finally:
            gc.callbacks.remove(callback)
        assert sent
        assert arrived == [signal.SIGTERM]
        with pytest.raises(Interrupted, match="SIGTERM"):
            progress("after", 1, 2)
