"""Files that are whole or not there."""

import pathlib
import signal
import subprocess
import sys
import time

import pytest

from agile_jax.files import check_folder, read_json, remove_torn, temporary_name, write_atomic
from agile_jax.settings import BadInput


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "a.bin"
    write_atomic(path, b"old")
    with pytest.raises(TypeError):
        write_atomic(path, "not bytes")  # type: ignore[arg-type]
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_kill_leaves_is_removed_and_nothing_else(tmp_path: pathlib.Path) -> None:
    program = (
        "import pathlib, sys\nfrom agile_jax.files import write_atomic\n"
        "while True:\n    write_atomic(pathlib.Path(sys.argv[1]) / 'sub' / 'a.bin', bytes(30_000_000))"
    )
    process = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)])
    deadline = time.monotonic() + 30
    while not list(tmp_path.glob("sub/.*.tmp")) and time.monotonic() < deadline:
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    process.wait()
    temporary_name(tmp_path / "b.bin").touch()
    theirs = {tmp_path / ".notes.tmp", tmp_path / "c.tmp"}
    for path in theirs:
        path.touch()
    remove_torn(tmp_path)
    left = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert left - {tmp_path / "sub/a.bin"} == theirs
    assert not (tmp_path / "sub/a.bin").exists() or (tmp_path / "sub/a.bin").stat().st_size == 30_000_000


def test_a_folder_that_leads_through_a_file_is_refused(tmp_path: pathlib.Path) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file/below"):
        with pytest.raises(BadInput, match=r"file: is a file, where a folder is needed"):
            check_folder(folder)
    check_folder(tmp_path / "new/below")


def test_a_folder_in_a_files_place_is_named(tmp_path: pathlib.Path) -> None:
    (tmp_path / "a.json").mkdir()
    assert read_json(tmp_path / "a.json") is None
    with pytest.raises(IsADirectoryError, match=r"a folder where a file belongs.*a\.json"):
        write_atomic(tmp_path / "a.json", b"{}")
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
