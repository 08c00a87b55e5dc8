"""Folders for what local workers write on the side. They go when the engine closes; those of an engine that was killed
go when the next one opens.

An engine holds a lock on a file in its folder. The kernel releases it when the process dies, however it dies, so a
folder whose lock can be had is nobody's; numbers of processes would be used again, and mean nothing in containers that
share a folder.
"""

import fcntl
import os
import pathlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

PREFIX = "agile-engine-"
LOCK = "held"


@contextmanager
def scratch_folder() -> Iterator[str]:
    """A folder of this process, removed at the end, after those of engines that were killed."""
    remove_stale()
    folder = pathlib.Path(tempfile.mkdtemp(prefix=PREFIX))
    lock = os.open(folder / f"{LOCK}.new", os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        os.rename(folder / f"{LOCK}.new", folder / LOCK)  # never there without being held
        yield str(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def remove_stale() -> None:
    """Remove the folders of this user that no living engine holds."""
    for folder in pathlib.Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        try:
            if folder.is_symlink() or folder.stat().st_uid != os.geteuid():
                continue
            lock = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW)
        except OSError:
            continue  # it has just gone, or is just being made
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for path in folder.iterdir():
                if path.name != LOCK:
                    shutil.rmtree(path, ignore_errors=True)
            # The lock's file goes last: workers outlive a killed engine by a moment, and may write once more.
            if [path.name for path in folder.iterdir()] == [LOCK]:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            pass  # held
        finally:
            os.close(lock)
