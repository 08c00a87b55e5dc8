"""Named arrays in npz files: the one place that writes and reads them. Never unpickled; damage is one exception."""

import io
import pathlib
import zipfile
import zlib
from collections.abc import Iterable, Mapping

import numpy as np

from agile_jax.files import write_atomic
from agile_jax.settings import BadInput

Arrays = dict[str, np.ndarray]
_DAMAGE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, SyntaxError)


class NpzError(ValueError):
    """Not an npz file of plain arrays, or a damaged one. The text says why, in one line."""


def npz_bytes(arrays: Mapping[str, np.ndarray]) -> bytes:
    """An npz file; NumPy stamps its members with a constant date, so equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def write_npz(path: pathlib.Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays atomically.

    Raises:
        OSError: the disk is full or the folder cannot be written; the old file is intact.
    """
    write_atomic(path, npz_bytes(arrays))


def read_npz(source: pathlib.Path | bytes) -> Arrays:
    """All arrays of a file, or of a file's bytes; zip checks their sums.

    Raises:
        NpzError: missing, damaged, or holding something else than plain arrays.
    """
    try:
        file = np.load(io.BytesIO(source) if isinstance(source, bytes) else source, allow_pickle=False)
        if isinstance(file, np.ndarray):
            raise ValueError("one array, not an archive of named ones")
        with file:
            arrays = {name: file[name] for name in file.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):  # NumPy gives other members as bytes
            raise ValueError("it holds something else than arrays")
        return arrays
    except _DAMAGE as error:
        raise NpzError(f"unreadable ({type(error).__name__}: {' '.join(str(error).split())})") from None


def keyed_bytes(key: str, rows: Mapping[str, np.ndarray]) -> bytes:
    """An npz file of rows with the key that they were made under (store/artefact.py)."""
    return npz_bytes({"key": np.array(key), **rows})


def read_keyed(source: pathlib.Path | bytes, key: str) -> Arrays:
    """The rows of a file of `keyed_bytes`, without the key.

    Raises:
        NpzError: as `read_npz`, or they were made under another key.
    """
    rows = read_npz(source)
    if str(rows.pop("key", "")) != key:
        raise NpzError("made with other settings or another seed")
    return rows


def load_npz(path: pathlib.Path, needed: Iterable[str] = ()) -> Arrays:
    """All arrays of a file that somebody has named, or that a stage has made.

    Args:
        path: of the file.
        needed: arrays that it must hold.

    Raises:
        BadInput: it cannot be used.
    """
    if not path.exists():
        raise BadInput(f"{path}: no such file")
    try:
        arrays = read_npz(path)
    except NpzError as error:
        raise BadInput(f"{path}: {error}") from None
    for name in needed:
        if name not in arrays:
            raise BadInput(f"{path}: the array {name} is missing")
    return arrays
