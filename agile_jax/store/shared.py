"""What several run directories share: parts of equal key are made once, published, and copied from there.

    <store>/<artefact>/<key>/<part>.npz    a part
    <store>/<artefact>/<key>/<part>.json   its sha256, how many items it holds, and how it was made

A part counts when its own JSON tells its sha256, so one that is damaged, half written, or written by two processes at
once is at worst made again. A run copies what it takes: damage in one folder does not reach the other.
"""

import logging
import pathlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

from agile_jax.files import read_json, sha256, write_atomic, write_json

_folder: ContextVar[pathlib.Path | None] = ContextVar("store", default=None)
logger = logging.getLogger(__name__)


@contextmanager
def sharing(folder: pathlib.Path | None) -> Iterator[None]:
    """Within this, parts are looked for and published in `folder`; None shares nothing."""
    token = _folder.set(folder)
    try:
        yield
    finally:
        _folder.reset(token)


def place(artefact: str, key: str) -> pathlib.Path | None:
    """Where parts of a key are shared; None when nothing is."""
    folder = _folder.get()
    return None if folder is None else folder / artefact / key[:32]


def take(path: pathlib.Path) -> tuple[bytes, dict[str, object]] | None:
    """A sound part's bytes and how it was made, or None."""
    about = read_json(path.with_suffix(".json"))
    try:
        data = path.read_bytes()
    except OSError:
        return None
    if about is None or about.get("sha256") != sha256(data):
        return None
    note = about.get("note")
    return data, note if isinstance(note, dict) else {}


def publish(path: pathlib.Path, data: bytes, items: int, note: Mapping[str, object]) -> None:
    """Offer a part to others, unless there is a sound one with as many items. A failure to write is only logged."""
    about = read_json(path.with_suffix(".json")) or {}
    there = about.get("items")
    if isinstance(there, int) and there >= items and take(path) is not None:
        return
    try:
        write_atomic(path, data)
        write_json(path.with_suffix(".json"), {"sha256": sha256(data), "items": items, "note": dict(note)})
    except OSError as error:
        logger.warning("%s is not shared: %s", path, error)
