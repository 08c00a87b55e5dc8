"""Experiment files as plain tables: TOML, inheritance through `extends`, overrides, and each key's origin."""

import difflib
import pathlib
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from agile_jax.settings import BadInput

LARGEST_FILE = 1_000_000  # [byte]; an experiment file is a few kilobytes, anything else is the wrong file

Path = tuple[str | int, ...]  # of a key: ("scene", "obstacles", 0, "position")


class Table(NamedTuple):
    """A parsed experiment, not yet validated."""

    values: dict[str, Any]
    origins: dict[Path, str]  # the file, or "command line", that set each key; an array's elements share its entry
    name: str  # of the file that was asked for


def read_table(path: pathlib.Path) -> Table:
    """Read an experiment file and its ancestors; tables merge deeply, arrays and values replace.

    Raises:
        BadInput: the file or an ancestor is missing, too large, not text or not TOML, or the ancestors form a circle.
    """
    lineage: list[tuple[pathlib.Path, dict[str, Any]]] = []
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

    merged: dict[str, Any] = {}
    origins: dict[Path, str] = {}
    for file, values in reversed(lineage):
        merged = _merge(merged, values)
        origins.update((key, str(file)) for key in _key_paths(values))
    return Table(merged, origins, str(path))


def override(table: Table, overrides: Mapping[str, Any], source: str = "command line") -> Table:
    """The table with dotted keys set, for example {"training.learning_rate": 0.1, "scene.obstacles.0.yaw": 0.2}.

    Raises:
        BadInput: a dotted key leads through something that is no table, or past an array's end.
    """
    values, origins = _copy(table.values), dict(table.origins)
    for dotted, value in overrides.items():
        node: Any = values
        path: list[str | int] = []
        *parents, last = dotted.split(".")
        for part in parents:
            if isinstance(node, list):
                node = node[_index(node, part, dotted, source)]
                path.append(int(part))
            elif isinstance(node, dict):
                path.append(part)
                if part not in node:
                    node[part] = {}
                    origins[tuple(path)] = source
                node = node[part]
            else:
                break
        if isinstance(node, list):
            node[_index(node, last, dotted, source)] = value
            path.append(int(last))
        elif isinstance(node, dict):
            node[last] = value
            path.append(last)
        else:
            raise BadInput(f"{source}: {dotted}: `{'.'.join(map(str, path))}` is a value and has no keys below it")
        origins[tuple(path)] = source
    return Table(values, origins, table.name)


def origin(table: Table, path: Path) -> str:
    """The file that set the key, or the nearest table around it."""
    for length in range(len(path), 0, -1):
        if path[:length] in table.origins:
            return table.origins[path[:length]]
    return table.name


def _parse(path: pathlib.Path, child: pathlib.Path | None) -> dict[str, Any]:
    """One file as a table; every way in which it can be unreadable is one message."""
    asked = f" (which {child} extends)" if child else ""
    if not path.exists():
        folder = path.parent
        names = sorted(file.name for file in folder.glob("*.toml")) if folder.is_dir() else []
        near = difflib.get_close_matches(path.name, names, 1)
        hint = f"; did you mean {folder / near[0]}?" if near else ""
        raise BadInput(f"{path}: no such file{asked}{hint}")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder{asked}; an experiment is one TOML file")
    if not path.is_file():
        raise BadInput(f"{path}: is not a regular file{asked}")
    if path.stat().st_size > LARGEST_FILE:
        raise BadInput(f"{path}: has {path.stat().st_size} bytes{asked}; an experiment file has at most {LARGEST_FILE}")
    try:
        text = path.read_bytes().decode()
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


def _merge(base: dict[str, Any], child: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in child.items():
        both_tables = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merge(base[key], value) if both_tables else value
    return merged


def _key_paths(values: dict[str, Any], prefix: Path = ()) -> Iterator[Path]:
    for key, value in values.items():
        yield (*prefix, key)
        if isinstance(value, dict):
            yield from _key_paths(value, (*prefix, key))


def _copy(value: Any) -> Any:
    """A deep copy in which every array is a list, so that overrides can reach into it."""
    if isinstance(value, dict):
        return {key: _copy(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_copy(item) for item in value]
    return value


def _index(array: list[Any], part: str, dotted: str, source: str) -> int:
    if part.isdecimal() and int(part) < len(array):
        return int(part)
    raise BadInput(f"{source}: {dotted}: `{part}` is no index of an array with {len(array)} elements (counted from 0)")
