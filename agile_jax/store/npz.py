"""NPZ files: written whole or not at all, read without unpickling, and refused as one error where they are damaged."""

import io
import pathlib
import zipfile
from collections.abc import Mapping

import numpy as np
from jaxtyping import Shaped

from agile_jax.files import write_atomic

DAMAGE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError, SyntaxError)
"""What NumPy and zipfile raise of a file that is missing, torn or something else."""


def npz_bytes(arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> bytes:
    """The content of an NPZ file with these arrays; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def write_npz(path: pathlib.Path, arrays: Mapping[str, Shaped[np.ndarray, "..."]]) -> None:
    """Write the arrays, by name, to a file that is never half there."""
    write_atomic(path, npz_bytes(arrays))


def read_npz(path: pathlib.Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """All arrays of a file, by name.

    Raises:
        One of DAMAGE: it is missing, damaged or no NPZ file.
    """
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}
