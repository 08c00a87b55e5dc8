"""The record of a stage: with what it was made, and every file of its result.

It is written before the work begins, without files, and again when all is there. Its own sha256 tells whether it is
sound. A result is finished when the record has the right key and every file that it names has its sha256.
"""

import pathlib
from collections.abc import Mapping
from typing import NamedTuple

from agile_jax.files import file_sha256, hash_json, read_json, write_json

_LEFT_OUT = {"stage.json", "timing.json", "quarantine", "tensorboard"}  # nothing depends on them


class Record(NamedTuple):
    """What `stage.json` holds."""

    stage: str
    key: str  # store/artefact.py
    amounts: dict[str, object]  # how much was asked for, by dotted setting
    settings: dict[str, object]  # all that decide on the result, by dotted path
    inputs: dict[str, str]  # digests of what it was made from
    files: dict[str, str] | None = None  # sha256 by path, relative to the run directory; None: not finished
    summary: dict[str, object] | None = None  # a copy, from which a damaged one is repaired


def write_record(path: pathlib.Path, record: Record) -> None:
    """Write a record with its own sha256."""
    content = record._asdict()
    write_json(path, content | {"sha256": hash_json(content)})


def read_record(path: pathlib.Path) -> Record | None:
    """A sound record, or None."""
    content = read_json(path)
    if content is None or content.keys() != {*Record._fields, "sha256"}:
        return None
    digest = content.pop("sha256")
    return Record(**content) if hash_json(content) == digest else None  # type: ignore[arg-type]  # as it was written


def list_files(run_dir: pathlib.Path, *places: pathlib.Path) -> dict[str, str]:
    """The sha256 of all files of a result, by path relative to the run directory.

    Args:
        run_dir: the run directory.
        places: files, and folders with all below them; what is not there is left out.
    """
    found = [file for place in places for file in ([place] if place.is_file() else sorted(place.rglob("*")))]
    return {
        file.relative_to(run_dir).as_posix(): file_sha256(file)
        for file in found
        if file.is_file() and not any(_is_left_out(part) for part in file.relative_to(run_dir).parts)
    }


def damaged(run_dir: pathlib.Path, files: Mapping[str, str]) -> list[str]:
    """The files that are missing or have another sha256."""
    found = []
    for name, digest in files.items():
        try:
            sound = file_sha256(run_dir / name) == digest
        except OSError:
            sound = False
        if not sound:
            found.append(name)
    return found


def _is_left_out(part: str) -> bool:
    return part in _LEFT_OUT or part.endswith((".damaged", ".tmp"))
