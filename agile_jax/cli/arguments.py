"""Typed options from the experiment's own models.

tyro reads dataclasses, so each settings model is mirrored by one that holds the loaded file's values and validates
nothing. What the command line changed is then applied to the file's table and validated there: a value is judged
alike wherever it was written.
"""

import dataclasses
import pathlib
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, TypeVar

import tyro
from pydantic import BaseModel

from agile_jax.experiment import Experiment, load_experiment
from agile_jax.experiment.validation import nested_models
from agile_jax.settings import BadInput

Options = TypeVar("Options")


def parse_experiment(
    command: str, options: Options, argv: Sequence[str], default: pathlib.Path | None = None
) -> tuple[Experiment, Options]:
    """Parse `EXPERIMENT.toml [options]`: the experiment with its overrides, and the command's own options.

    Args:
        command: for the usage line.
        options: a dataclass instance with the defaults; tyro.MISSING where there is none.
        argv: the arguments after the command.
        default: the file that is read when none is named.

    Raises:
        BadInput: no experiment, a bad file, or a bad value.
        SystemExit: with code 2 for an unknown option, 0 after --help.
    """
    path, rest = _split_path(argv)
    path = path or default
    if path is None and not {"-h", "--help"} & set(rest):
        raise BadInput(
            f"which experiment? usage: agile {command} EXPERIMENT.toml [OPTIONS]; see `agile {command} --help`"
        )
    experiment = load_experiment(path) if path else Experiment(name="experiment")
    mirror = mirrored(experiment)
    unnamed = tyro.conf.arg(name="")
    arguments = dataclasses.make_dataclass(
        "Arguments", [("options", Annotated[type(options), unnamed]), ("experiment", Annotated[type(mirror), unnamed])]
    )
    parsed = _tyro(command, "EXPERIMENT.toml", arguments, arguments(options, mirror), rest)
    changed = dict(_changes(parsed.experiment, mirror))
    return (load_experiment(path, changed) if path and changed else experiment), parsed.options


def parse_run_dir(command: str, options: Options, argv: Sequence[str]) -> tuple[pathlib.Path, Options]:
    """Parse `RUN_DIR [options]`."""
    if argv and not argv[0].startswith("-"):
        path, rest = pathlib.Path(argv[0]), list(argv[1:])
    else:
        path, rest = None, list(argv)
    if path is None and not {"-h", "--help"} & set(rest):
        raise BadInput(f"which run directory? usage: agile {command} RUN_DIR [OPTIONS]; see `agile {command} --help`")
    parsed: Options = _tyro(command, "RUN_DIR", type(options), options, rest)
    assert path is not None
    return path, parsed


def mirrored(model: BaseModel) -> Any:
    """A frozen dataclass instance with the model's values; nested models and arrays of models are mirrored, too.

    Left out, since a flag cannot express it: dictionaries, empty arrays of models, and the sweep.
    """
    fields, values = [], []
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        kind: Any
        if isinstance(value, BaseModel):
            value = mirrored(value)
            kind = type(value)
        elif isinstance(value, tuple) and value and all(isinstance(item, BaseModel) for item in value):
            value = tuple(mirrored(item) for item in value)
            kind = tuple[tuple(type(item) for item in value)]  # type: ignore[misc]
        elif isinstance(value, dict) or any(nested_models(field.annotation)):
            continue
        else:
            kind = Annotated[field.annotation, tyro.conf.arg(help=" ".join((field.description or "").split()))]
        if name != "sweep":
            fields.append((name, kind))
            values.append(value)
    return dataclasses.make_dataclass(type(model).__name__, fields, frozen=True)(*values)


def _tyro(command: str, positional: str, kind: Any, default: Any, argv: Sequence[str]) -> Any:
    return tyro.cli(
        kind, prog=f"agile {command} {positional}", description=None, args=list(argv), default=default, add_help=True
    )


def _split_path(argv: Sequence[str]) -> tuple[pathlib.Path | None, list[str]]:
    """The experiment file: the first argument, or else the first that ends in .toml."""
    for i, argument in enumerate(argv):
        if not argument.startswith("-") and (i == 0 or argument.endswith(".toml")):
            return pathlib.Path(argument), [*argv[:i], *argv[i + 1 :]]
    return None, list(argv)


def _changes(parsed: Any, default: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values by dotted key that differ from the file's."""
    if dataclasses.is_dataclass(default):
        for field in dataclasses.fields(default):
            key = f"{prefix}.{field.name}" if prefix else field.name
            yield from _changes(getattr(parsed, field.name), getattr(default, field.name), key)
    elif isinstance(default, tuple) and default and all(dataclasses.is_dataclass(item) for item in default):
        for i, (new, old) in enumerate(zip(parsed, default, strict=True)):
            yield from _changes(new, old, f"{prefix}.{i}")
    elif parsed != default:
        yield prefix, list(parsed) if isinstance(parsed, tuple) else parsed
