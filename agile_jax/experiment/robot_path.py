"""The path of a robot's MJCF is relative to the experiment file that sets it, wherever the command runs."""

import os
import pathlib
from collections.abc import Iterator

from agile_jax.experiment.file import Table, origin
from agile_jax.robot.settings import OWN


def resolve_robot_paths(table: Table) -> Table:
    """The table with absolute paths of robots, also of those that its sweep or study varies; `table` itself is changed.

    A path from the command line is relative to the working directory.
    """
    own, sweep = table.values, table.values.get("sweep")
    _resolve(own, table, ("robot", "name"))
    if isinstance(sweep, dict):
        points = sweep.get("points")
        for point in points if isinstance(points, list) else []:
            _resolve(point, table, ("sweep", "points"))
        _resolve(sweep.get("space"), table, ("sweep", "space"))
    study = table.values.get("study")
    if isinstance(study, dict):
        _resolve(study.get("curves"), table, ("study", "curves"))
    return table


def _resolve(values: object, table: Table, where: tuple[str, ...]) -> None:
    """Make every `robot.name` in `values` absolute, seen from the file that set the key `where`."""
    set_by = pathlib.Path(origin(table, where))
    folder = set_by.parent if set_by.is_file() else pathlib.Path()
    for holder, key in _robot_names(values):
        named = holder[key]
        if isinstance(named, list):  # the values of a sweep
            holder[key] = [_absolute(folder, one) for one in named]
        else:
            holder[key] = _absolute(folder, named)


def _robot_names(values: object) -> Iterator[tuple[dict[str, object], str]]:
    if isinstance(values, dict):
        if "robot.name" in values:
            yield values, "robot.name"
        robot = values.get("robot")
        if isinstance(robot, dict) and "name" in robot:
            yield robot, "name"


def _absolute(folder: pathlib.Path, name: object) -> object:
    if not isinstance(name, str) or name in ("", OWN):
        return name
    return os.path.abspath(folder / pathlib.Path(name).expanduser())
