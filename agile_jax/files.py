"""Files that are either whole or not there."""

import errno
import hashlib
import json
import os
import pathlib
import re
import uuid
from functools import lru_cache

from agile_jax.settings import BadInput


def write_atomic(path: pathlib.Path, data: bytes) -> None:
    """Write `data` to `path` so that a reader, or a kill at any moment, sees the old file or the new one.

    Raises:
        OSError: the disk is full or the folder cannot be written; the old file is intact. Or `path` is a folder.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder where a file belongs; move it away", str(path))
    temporary = temporary_name(path)
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def temporary_name(path: pathlib.Path) -> pathlib.Path:
    """Where to write what will be moved to `path`; `remove_torn` knows such names."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")


def remove_torn(folder: pathlib.Path) -> None:
    """Delete what a kill has left of writes anywhere below `folder`, where nobody else may be at work."""
    for path in folder.rglob(".*.tmp"):
        if re.fullmatch(r"\..+\.[0-9a-f]{32}\.tmp", path.name):
            path.unlink(missing_ok=True)


def check_folder(folder: pathlib.Path) -> None:
    """Refuse (BadInput) a folder that leads through a file, or whose path is not UTF-8, where Orbax could not write."""
    try:
        str(folder.resolve()).encode()
    except UnicodeEncodeError:
        raise BadInput(f"{str(folder)!r}: is not UTF-8 text; use another folder") from None
    for path in (folder, *folder.parents):
        if path.exists() and not path.is_dir():
            raise BadInput(f"{path}: is a file, where a folder is needed; use another folder")


def sync_folder(folder: pathlib.Path) -> None:
    """Make a rename inside `folder` durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: pathlib.Path, value: object) -> None:
    """Write `value` as readable JSON with sorted keys, atomically. NaN is refused (ValueError): JSON has none."""
    write_atomic(path, (json.dumps(value, indent=2, sort_keys=True, allow_nan=False) + "\n").encode())


def read_json(path: pathlib.Path) -> dict[str, object] | None:
    """A JSON object, or None when the file is missing, torn or something else, such as a folder."""
    try:
        value = json.loads(path.read_bytes())
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError, ValueError):
        return None
    return value if isinstance(value, dict) else None


def sha256(data: bytes) -> str:
    """The hexadecimal sha256 of `data`."""
    return hashlib.sha256(data).hexdigest()


def file_sha256(path: pathlib.Path) -> str:
    """The hexadecimal sha256 of a file. While nobody has written to it, it is read once in a process.

    Raises:
        OSError: it is missing or cannot be read.
    """
    about = path.stat()
    state = (about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns)
    return _file_sha256(str(path.absolute()), state)


@lru_cache(maxsize=100_000)
def _file_sha256(path: str, state: tuple[int, ...]) -> str:
    del state  # another one is another file
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def hash_json(value: object) -> str:
    """The sha256 of a JSON value in canonical form (sorted keys, no spaces)."""
    return sha256(json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode())
