"""The arguments of a command: an experiment with its overrides or a run directory, and the command's own options."""

import pathlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Generic, NamedTuple, TypeVar

from agile_jax.cli.exit_codes import DONE
from agile_jax.cli.help import help_text, help_wanted
from agile_jax.cli.options import Option, option_name, options_of, read_options, read_path
from agile_jax.experiment import Experiment, load_experiment
from agile_jax.experiment.file import read_table
from agile_jax.experiment.validation import dotted, validate
from agile_jax.settings import BadInput, Settings

Options = TypeVar("Options", bound=Settings)
Result = TypeVar("Result")

EITHER = "EXPERIMENT.toml|RUN_DIR"


class Request(NamedTuple, Generic[Options]):
    """What a command is asked to do."""

    experiment: Experiment
    options: Options
    run_dir: pathlib.Path | None  # that was named in place of a file


def parse_experiment(
    command: str,
    model: type[Options],
    argv: Sequence[str],
    default: pathlib.Path | None = None,
    takes: str = "EXPERIMENT.toml",
) -> Request[Options]:
    """Parse `EXPERIMENT.toml [OPTIONS]`, or `RUN_DIR [OPTIONS]` where the command goes on in one.

    Args:
        command: for the usage line.
        model: of the command's own options.
        argv: the arguments after the command.
        default: the file that is read when none is named.
        takes: what the usage line says; a RUN_DIR is taken for EITHER.

    Raises:
        BadInput: no experiment; or all that is wrong with the file and the options.
        SystemExit: with code 0, after --help.
    """
    usage = f"agile {command} {f'[{takes}]' if default else takes}"
    named, words = _split_path(argv)
    path, run_dir = (named or default), None
    if takes == EITHER and named is not None and named.is_dir():
        path, run_dir = named / "experiment.toml", named
        if not path.is_file():
            raise BadInput(f"{named}: is a folder without an experiment.toml; name an experiment or a run directory")
    if path is None and help_wanted(argv) is None:
        raise BadInput(f"which experiment? usage: {usage} [OPTIONS]; see `agile {command} --help`")
    in_file: list[str] = []  # what is wrong there, unless an option mends it
    table = read_table(path).values if path else {}
    experiment = _try(lambda: load_experiment(path) if path else Experiment(name="experiment"), in_file)
    settings = list(options_of(Experiment, experiment or table))
    options, overrides, errors = _read(usage, model, words, settings)
    if path and overrides:
        experiment = _try(lambda: load_experiment(path, overrides), errors)
    else:
        errors += in_file
    if experiment is None or options is None or errors:
        raise BadInput("\n".join(errors))
    return Request(experiment, options, run_dir)


def parse_run_dir(command: str, model: type[Options], argv: Sequence[str]) -> tuple[pathlib.Path, Options]:
    """Parse `RUN_DIR [OPTIONS]`.

    Raises:
        BadInput: no run directory, or all that is wrong with the options.
        SystemExit: with code 0, after --help.
    """
    usage = f"agile {command} RUN_DIR"
    if (not argv or argv[0].startswith("-")) and help_wanted(argv) is None:
        raise BadInput(f"which run directory? usage: {usage} [OPTIONS]; see `agile {command} --help`")
    options, _, errors = _read(usage, model, argv[1:] if argv[0][:1] != "-" else argv, [])
    if options is None or errors:
        raise BadInput("\n".join(errors))
    return read_path(argv[0]), options


def _read(
    usage: str, model: type[Options], words: Sequence[str], settings: Sequence[Option]
) -> tuple[Options | None, dict[str, object], list[str]]:
    """The command's own options, the experiment's overrides, and what is wrong with them. Prints help."""
    own = list(options_of(model, {}))
    if (wanted := help_wanted(words)) is not None:
        print(help_text(usage, own, settings, wanted))
        raise SystemExit(DONE)
    given, errors = read_options(words, [*own, *settings])
    overrides = {key: value for key, value in given.items() if key not in model.model_fields}
    mine = {key: value for key, value in given.items() if key in model.model_fields}
    make = partial(validate, model, mine, lambda key: "command line", lambda key: option_name(dotted(key)))
    return _try(make, errors), overrides, errors


def _try(make: Callable[[], Result], errors: list[str]) -> Result | None:
    """What is made, or None and what is wrong with it."""
    try:
        return make()
    except BadInput as error:
        errors.append(str(error))
        return None


def _split_path(argv: Sequence[str]) -> tuple[pathlib.Path | None, list[str]]:
    """The experiment: the first argument, or else the first that ends in .toml; and the other arguments."""
    for i, argument in enumerate(argv):
        if not argument.startswith("-") and (i == 0 or argument.endswith(".toml")):
            return read_path(argument), [*argv[:i], *argv[i + 1 :]]
    return None, list(argv)
