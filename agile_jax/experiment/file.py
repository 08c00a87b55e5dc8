"""Experiment files as plain tables: TOML, inheritance through `extends`, overrides, and each key's origin."""

import copy
import difflib
import pathlib
import tomllib
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from agile_jax.settings import BadInput

LARGEST_FILE = 1_000_000  # [byte]; an experiment file is a few kilobytes, anything else is the wrong file

KeyPath = tuple[str | int, ...]  # ("scene", "obstacles", 0, "position")
Values = dict[str, object]  # a table, as TOML has it


class Table(NamedTuple):
    """A parsed experiment, not yet validated."""

    values: Values
    origins: dict[KeyPath, str]  # the file, or "command line", that set each key; an array's elements share its entry
    name: str  # of the file that was asked for


def read_table(path: pathlib.Path) -> Table:
    """Read an experiment file and its ancestors; tables merge deeply, arrays and values replace.

    Raises:
        BadInput: the file or an ancestor is missing, too large, not text or not TOML, or the ancestors form a circle.
    """
    lineage: list[tuple[pathlib.Path, Values]] = []
    current: pathlib.Path | None = path
    while current is not None:
        seen = [file.resolve() for file, _ in lineage]
        if current.resolve() in seen:
            circle = " -> ".join(str(file) for file, _ in lineage) + f" -> {current}"
            raise BadInput(f"{path}: `extends` goes round in a circle: {circle}")
        values = _parse(current, lineage[-1][0] if lineage else None)
        parent = values.pop("extends", None)
        if parent is not None and not (isinstance(parent, str) and parent):
            raise BadInput(
                f"{current}: extends = {parent!r}: must be the path of one experiment file, relative to this one"
            )
        lineage.append((current, values))
        current = current.parent / parent if parent is not None else None

    merged: Values = {}
    origins: dict[KeyPath, str] = {}
    for file, values in reversed(lineage):
        merged = _merge(merged, values)
        origins.update((key, str(file)) for key in _keys(values))
    return Table(merged, origins, str(path))


def override(table: Table, overrides: Mapping[str, object], source: str = "command line") -> Table:
    """The table with dotted keys set, for example {"training.learning_rate": 0.1, "scene.obstacles.0.yaw": 0.2}.

    Raises:
        BadInput: a dotted key leads through something that is no table, or past an array's end.
    """
    values, origins = copy.deepcopy(table.values), dict(table.origins)
    for dotted, value in overrides.items():
        node: object = values
        key: KeyPath = ()
        *parents, last = dotted.split(".")
        for part in parents:
            if isinstance(node, list):
                index = _index(node, part, dotted, source)
                node, key = node[index], (*key, index)
            elif isinstance(node, dict):
                key = (*key, part)
                if part not in node:
                    node[part] = {}
                    origins[key] = source
                node = node[part]
            else:
                break
        if isinstance(node, list):
            index = _index(node, last, dotted, source)
            node[index], key = value, (*key, index)
        elif isinstance(node, dict):
            node[last], key = value, (*key, last)
        else:
            raise BadInput(f"{source}: {dotted}: `{'.'.join(map(str, key))}` is a value and has no keys below it")
        origins[key] = source
    return Table(values, origins, table.name)


def origin(table: Table, key: KeyPath) -> str:
    """The file that set the key, or the nearest table around it."""
    for length in range(len(key), 0, -1):
        if key[:length] in table.origins:
            return table.origins[key[:length]]
    return table.name


def _parse(path: pathlib.Path, child: pathlib.Path | None) -> Values:
    """One file as a table; every way in which it can be unreadable is one message."""
    asked = f" (which {child} extends)" if child else ""
    if not path.exists():
        near = difflib.get_close_matches(path.stem, _experiments_in(path.parent), 1)
        hint = f"; did you mean {path.parent / near[0]}.toml?" if near else ""
        raise BadInput(f"{path}: no such file{asked}{hint}")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder{asked}; an experiment is one TOML file")
    if not path.is_file():
        raise BadInput(f"{path}: is not a regular file{asked}")
    if path.stat().st_size > LARGEST_FILE:
        raise BadInput(f"{path}: has {path.stat().st_size} bytes{asked}; an experiment file has at most {LARGEST_FILE}")
    try:
        text = path.read_bytes().decode("utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError:
        raise BadInput(f"{path}: is not UTF-8 text{asked}; an experiment is a TOML file") from None
    if not text.strip():
        raise BadInput(f"{path}: is empty{asked}; an experiment needs at least a name")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{path}: is not valid TOML{asked}: {error}") from None
    except RecursionError:
        raise BadInput(f"{path}: is nested too deeply{asked}") from None


def _experiments_in(folder: pathlib.Path) -> Iterator[str]:
    """The names without .toml of the experiment files in a folder: every experiment, or what it extends, has a name."""
    for path in sorted(folder.glob("*.toml")) if folder.is_dir() else ():
        try:
            values = _parse(path, None)
        except (BadInput, OSError):
            continue
        if {"name", "extends"} & values.keys():
            yield path.stem


def _merge(base: Values, child: Values) -> Values:
    merged = dict(base)
    for key, value in child.items():
        old = base.get(key)
        merged[key] = _merge(old, value) if isinstance(value, dict) and isinstance(old, dict) else value
    return merged


def _keys(values: Values, prefix: KeyPath = ()) -> Iterator[KeyPath]:
    for key, value in values.items():
        yield (*prefix, key)
        if isinstance(value, dict):
            yield from _keys(value, (*prefix, key))


def _index(array: list[object], part: str, dotted: str, source: str) -> int:
    if part.isdecimal() and int(part) < len(array):
        return int(part)
    raise BadInput(f"{source}: {dotted}: `{part}` is no index of an array with {len(array)} elements (counted from 0)")
