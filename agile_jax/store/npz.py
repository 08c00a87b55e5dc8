"""Named arrays in npz files: the one place that writes and reads them. Never unpickled; damage is one exception."""

import io
import pathlib
import zipfile
import zlib
from collections.abc import Mapping

import numpy as np

from agile_jax.files import write_atomic

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
