"""Work in parts: files of some items each, which are whole, of the right key, or not used.

    part-00000.npz ...   the rows of `size` items each, with the key and the items; zip checks their sums
    timing.json          how they were made; no part of the result
    quarantine/          files that were not what they should be

An item is what one row is about, such as the number of a label or the pose that a path starts from. More items, or
others, leave the rows that are there as they are; a part with more rows than are wanted keeps them.
"""

import logging
import os
import pathlib
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Int, Shaped

from agile_jax.engine import Engine, TaskFailure, TasksFailedError
from agile_jax.files import hash_json, read_json, sha256, sync_folder, write_atomic, write_json
from agile_jax.progress import Progress, silent
from agile_jax.store import shared
from agile_jax.store.npz import Arrays, keyed_bytes, read_keyed

Task = TypeVar("Task")
OpenEngine = Callable[[], AbstractContextManager[Engine]]
logger = logging.getLogger(__name__)


class Made(NamedTuple):
    """What a task has made."""

    arrays: Arrays  # first axes count the task's items
    note: Mapping[str, object] | None = None  # how it went: times, which are no part of the result


class PartFile(NamedTuple):
    """A part on disk."""

    name: str
    sha256: str  # of the file
    rows: Arrays  # all that it holds
    wanted: Int[np.ndarray, " k"]  # the rows that are asked for, in the items' order; -1: not there

    def chosen(self) -> Arrays:
        """The rows that are asked for and there."""
        return {name: rows[self.wanted[self.wanted >= 0]] for name, rows in self.rows.items()}


class Parts:
    """The rows of all items, as far as they are there; `add` puts in those of a part that were missing."""

    def __init__(
        self,
        folder: pathlib.Path,
        artefact: str,
        key: str,
        items: Shaped[np.ndarray, " n"],
        size: int,
        *,
        name: str = "part",
        item_name: str = "item",
        check: Callable[[Arrays], None] = lambda rows: None,
        listed: Mapping[str, tuple[int, str]] | None = None,
    ) -> None:
        """Look at what is there; what is not sound goes to quarantine.

        Args:
            folder: of the parts.
            artefact: what they are, for the shared store.
            key: of the artefact; a part of another one is not used.
            items: numbers or short strings that tell the items apart.
            size: items in a file.
            name: of the files.
            item_name: under which a file holds its items.
            check: raises ValueError, with the cause, for rows that are not what they should be.
            listed: rows and sha256 of files, by name, as far as a manifest knows them.
        """
        self.folder, self.items, self.size = folder, items, size
        self._artefact, self.key, self._name, self._item_name = artefact, key, name, item_name
        self._check, self._listed = check, listed or {}
        self._found: dict[int, PartFile] = {}
        timing = read_json(folder / "timing.json") or {}
        notes = timing.get("parts") if timing.get("key") == key else None
        self.notes: dict[str, dict[str, object]] = dict(notes) if isinstance(notes, dict) else {}
        for part in range(-(-len(items) // size)):
            self._look(part)

    def missing(self) -> list[Int[np.ndarray, " k"]]:
        """The numbers of the items without rows, by part."""
        found = []
        for part in range(-(-len(self.items) // self.size)):
            first, count = part * self.size, len(self._members(part))
            there = self._found.get(part)
            lacking = np.arange(count) if there is None else np.flatnonzero(there.wanted < 0)
            if len(lacking):
                found.append(first + lacking)
        return found

    def done(self) -> int:
        """How many items have rows."""
        return len(self.items) - sum(map(len, self.missing()))

    def file_name(self, part: int) -> str:
        """The name of a part's file."""
        return f"{self._name}-{part:05d}.npz"

    def add(self, numbers: Int[np.ndarray, " k"], made: Made) -> None:
        """Write the rows of some items of one part, beside those that it has.

        Raises:
            OSError: the disk is full or cannot be written; what is there stays whole.
        """
        part = int(numbers[0]) // self.size
        rows = {self._item_name: self.items[numbers], **made.arrays}
        self._write(part, rows, made.note)
        place, found = shared.place(self._artefact, self.key), self._found[part]
        if place is not None and (found.wanted >= 0).all():
            data = (self.folder / found.name).read_bytes()
            shared.publish(place / self._shared_name(part), data, len(found.wanted), self.notes.get(found.name, {}))

    def files(self) -> list[PartFile]:
        """The parts that are there."""
        return [self._found[part] for part in sorted(self._found)]

    def arrays(self) -> Arrays:
        """The rows of all items, in their order; none may be missing."""
        chosen = [file.chosen() for file in self.files()]
        return {name: np.concatenate([rows[name] for rows in chosen]) for name in chosen[0]} if chosen else {}

    def digest(self) -> str:
        """The hash of key and rows, whatever else the files hold."""
        return hash_json([self.key, *(self.digest_of(file) for file in self.files())])

    def digest_of(self, file: PartFile) -> str:
        """The sha256 that a file of the wanted rows alone has."""
        count = len(file.rows[self._item_name])
        if np.array_equal(file.wanted, np.arange(count)):
            return file.sha256
        return sha256(keyed_bytes(self.key, file.chosen()))

    def _members(self, part: int) -> Shaped[np.ndarray, " k"]:
        return self.items[part * self.size : (part + 1) * self.size]

    def _shared_name(self, part: int) -> str:
        """Numbered items are the same in every run; of others a part is told by what it holds."""
        if self.items.dtype.kind in "iu":
            return self.file_name(part)
        return f"{self._name}-{hash_json(self._members(part).tolist())[:16]}.npz"

    def _look(self, part: int) -> None:
        """Take up a part from the folder, and what it lacks from the shared store."""
        path = self.folder / self.file_name(part)
        if path.exists():
            try:
                self._take(part, path.read_bytes(), self._listed.get(path.name))
            except (OSError, ValueError) as error:
                set_aside(path, str(error))
        place = shared.place(self._artefact, self.key)
        if place is None or (part in self._found and (self._found[part].wanted >= 0).all()):
            return
        offered = shared.take(place / self._shared_name(part))
        if offered is None:
            return
        try:
            rows = self._sound(offered[0])
        except ValueError as error:
            logger.warning("%s is not used: %s", place / self._shared_name(part), error)
            return
        there = self._found.get(part)
        lacking = self._members(part) if there is None else self._members(part)[there.wanted < 0]
        order = _positions(rows[self._item_name], lacking)
        if (order >= 0).any():
            chosen = {name: values[order[order >= 0]] for name, values in rows.items()}
            self._write(part, chosen, offered[1])

    def _write(self, part: int, rows: Arrays, note: Mapping[str, object] | None) -> None:
        """Put rows beside those that a part has; those that are asked for come first, in their order."""
        there = self._found.get(part)
        if there is not None:
            rows = {name: np.concatenate([there.rows[name], values]) for name, values in rows.items()}
        order = _positions(rows[self._item_name], self._members(part))
        order = order[order >= 0]
        rest = np.setdiff1d(np.arange(len(rows[self._item_name])), order)
        rows = {name: values[np.concatenate([order, rest])] for name, values in rows.items()}
        name = self.file_name(part)
        if note:
            self.notes[name] = _sum(self.notes.get(name, {}) if there is not None else {}, note)
        data = keyed_bytes(self.key, rows)
        write_atomic(self.folder / name, data)
        if note:
            write_json(self.folder / "timing.json", {"key": self.key, "parts": self.notes})
        self._take(part, data, None)

    def _take(self, part: int, data: bytes, listed: tuple[int, str] | None) -> None:
        rows, digest = self._sound(data), sha256(data)
        items = rows[self._item_name]
        # A part that has grown is not yet the one that the manifest lists.
        if listed is not None and listed[0] == len(items) and listed[1] != digest:
            raise ValueError("its sha256 is not the manifest's")
        self._found[part] = PartFile(self.file_name(part), digest, rows, _positions(items, self._members(part)))

    def _sound(self, data: bytes) -> Arrays:
        """The rows in a file's bytes; ValueError says why they are not used."""
        rows = read_keyed(data, self.key)
        items = rows.get(self._item_name)
        if items is None or items.ndim != 1 or items.dtype.kind != self.items.dtype.kind:
            raise ValueError(f"array {self._item_name} is missing or of another kind")
        if any(values.ndim == 0 or len(values) != len(items) for values in rows.values()):
            raise ValueError(f"its arrays do not have the {len(items)} rows of {self._item_name}")
        self._check(rows)
        return rows


def complete(
    parts: Parts,
    make: Callable[[Task], Made],
    task: Callable[[Int[np.ndarray, " k"]], Task],
    engine: OpenEngine,
    time_limit_s: float,
    progress: Progress = silent,
    work: str = "parts",
) -> None:
    """Make the rows that are missing; the engine is opened only when there are some.

    Args:
        parts: what is there.
        make: one task's rows; a function of a module. Runs in a worker.
        task: its argument for some items, by their numbers.
        engine: opens the work engine.
        time_limit_s: of one task [s].
        progress: is told of every part.
        work: what the items are, in words.

    Raises:
        TasksFailedError: a task failed for good; what the others made is kept.
    """
    missing = parts.missing()
    done, total = parts.done(), len(parts.items)
    progress(work, done, total)
    if not missing:
        return
    failures = []
    with engine() as opened:
        for position, result in opened.map(make, [task(numbers) for numbers in missing], time_limit_s):
            numbers = missing[position]
            if isinstance(result, TaskFailure):
                failures.append(f"{parts.file_name(int(numbers[0]) // parts.size)}: {result.cause}")
                continue
            note = None if result.note is None else {**result.note, "workers": opened.workers}
            parts.add(numbers, Made(result.arrays, note))
            done += len(numbers)
            progress(work, done, total)
    if failures:
        raise TasksFailedError(
            f"{parts.folder}: {len(failures)} parts could not be made ({'; '.join(sorted(failures))}); "
            "the others are kept, and the same command tries again"
        )


def row_items(rows: Shaped[np.ndarray, "n _"]) -> Shaped[np.ndarray, " n"]:
    """Short strings that tell rows of numbers apart, such as poses."""
    return np.array([sha256(row.tobytes())[:32] for row in np.asarray(rows, float)], dtype="U32")


def set_aside(path: pathlib.Path, cause: str) -> None:
    """Move a file that is not what it should be to quarantine/ beside it."""
    folder = path.parent / "quarantine"
    folder.mkdir(exist_ok=True)
    number = 0
    while (target := folder / f"{path.name}.{number}").exists():
        number += 1
    os.replace(path, target)
    sync_folder(path.parent)
    logger.warning("%s moved to quarantine/%s: %s", path, target.name, cause)


def _positions(there: Shaped[np.ndarray, " m"], wanted: Shaped[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
    """Where each wanted item stands; -1 where it does not."""
    where = {item: i for i, item in enumerate(there.tolist())}
    return np.array([where.get(item, -1) for item in wanted.tolist()], int)


def _sum(old: Mapping[str, object], new: Mapping[str, object]) -> dict[str, object]:
    """Two notes as one: numbers are added and lists joined, but the number of workers is the last one's."""
    joined = dict(old)
    for name, value in new.items():
        before = joined.get(name)
        both = isinstance(before, list) and isinstance(value, list)
        if both or (isinstance(before, float) and isinstance(value, float)):
            value = before + value  # type: ignore[operator]
        joined[name] = value
    return joined
