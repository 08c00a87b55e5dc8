"""How benchmarks measure: clocks, and what ran on what."""

import os
import platform
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Spent(NamedTuple):
    """What a call took."""

    wall: float  # [s]
    cpu: float  # [s] of all threads of this process


def timed(work: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> tuple[R, Spent]:
    """What a call returns, and what it took."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work(*args, **kwargs)
    return result, Spent(time.perf_counter() - wall, time.process_time() - cpu)


def machine(**more: object) -> dict[str, object]:
    """The machine, for a result's file."""
    return {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version(), **more}


def versions(*names: str) -> dict[str, str | None]:
    """The installed versions of distributions; None where one is not installed."""
    return {name: _version(name) for name in names}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
