"""Work of the expert in parts that are whole, of the right question, or not there: what a killed stage goes on from.

part-00000.npz ...    one task's arrays each, with the key of the question; zip checks their sums when they are read
"""

import io
import pathlib
import zipfile
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from agile_jax.engine import Engine, TaskFailure, TasksFailedError
from agile_jax.files import hash_json, sha256, write_atomic
from agile_jax.progress import Progress, silent

Arrays = dict[str, np.ndarray]


def complete_parts(
    directory: pathlib.Path,
    key: str,
    make: Callable[[Any], Arrays],
    tasks: Sequence[Any],
    engine: Callable[[], AbstractContextManager[Engine]],
    time_limit_s: float,
    progress: Progress = silent,
) -> tuple[Arrays, str]:
    """Do the tasks that are not done yet; the engine is opened only when there is one.

    Args:
        directory: of the parts.
        key: names the question; a part of another one is made anew.
        make: one task's arrays, whose first axes count the same things; a function of a module.
        tasks: its arguments.
        engine: opens the work engine.
        time_limit_s: of one task [s].
        progress: is told of every part.

    Returns:
        The arrays of all parts, joined along their first axes, and the hash of key and parts.

    Raises:
        TasksFailedError: a task failed for good; the other parts are kept.
    """
    paths = [directory / f"part-{i:05d}.npz" for i in range(len(tasks))]
    found = {i: arrays for i, path in enumerate(paths) if (arrays := _load(path, key)) is not None}
    missing = [i for i in range(len(tasks)) if i not in found]
    failures = []
    if missing:
        with engine() as workers:
            for position, result in workers.map(make, [tasks[i] for i in missing], time_limit_s):
                i = missing[position]
                if isinstance(result, TaskFailure):
                    failures.append(f"{paths[i].name}: {result.cause}")
                    continue
                buffer = io.BytesIO()
                np.savez(buffer, allow_pickle=False, key=np.array(key), **result)
                write_atomic(paths[i], buffer.getvalue())
                found[i] = result
                progress(directory.name, len(found), len(tasks), "parts")
    if failures:
        raise TasksFailedError(f"{directory}: {'; '.join(sorted(failures))}; the other parts are kept")
    digest = hash_json([key, *(sha256(path.read_bytes()) for path in paths)])
    names = found[0] if found else {}
    return {name: np.concatenate([found[i][name] for i in range(len(tasks))]) for name in names}, digest


def _load(path: pathlib.Path, key: str) -> Arrays | None:
    """The arrays of a sound part of this question."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError, SyntaxError):
        return None
    return arrays if str(arrays.pop("key", "")) == key else None
