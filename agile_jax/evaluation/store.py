"""Columns of an evaluation on disk: npz files that are whole, of the right settings, or not there."""

import io
import pathlib
import zipfile

import numpy as np

from agile_jax.files import write_atomic
from agile_jax.settings import BadInput
from agile_jax.simulation import Trace

Columns = dict[str, np.ndarray]


def save_columns(path: pathlib.Path, columns: Columns) -> None:
    """Write named arrays as npz, atomically; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **columns)
    write_atomic(path, buffer.getvalue())


def save_chunk(path: pathlib.Path, identity: str, columns: Columns) -> None:
    """Commit a part of the evaluation that `identity` names."""
    save_columns(path, {"identity": np.array(identity), **columns})


def load_chunk(path: pathlib.Path, identity: str) -> Columns | None:
    """The columns of a committed part; None when it is not there, damaged, or of another evaluation."""
    try:
        with np.load(path, allow_pickle=False) as file:
            columns = {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    if str(columns.pop("identity", "")) != identity:
        return None
    return columns


def save_traces(path: pathlib.Path, traces: list[Trace]) -> None:
    """Traces padded to the longest with their last sample; `length` (n,) tells how many samples count."""
    longest = max(len(trace.time) for trace in traces)

    def pad(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, np.repeat(values[-1:], longest - len(values), 0)])

    columns = {name: np.stack([pad(getattr(trace, name)) for trace in traces]) for name in Trace._fields}
    save_columns(path, {"length": np.array([len(trace.time) for trace in traces]), **columns})


def load_traces(path: pathlib.Path) -> list[Trace]:
    """What `save_traces` wrote.

    Raises:
        BadInput: no such file, or it holds no traces.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            columns = {name: file[name] for name in ("length", *Trace._fields)}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{path}: holds no recorded episodes ({error})") from None
    return [Trace(*(columns[name][i, :n] for name in Trace._fields)) for i, n in enumerate(columns["length"])]
