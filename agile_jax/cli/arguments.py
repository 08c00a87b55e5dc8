"""The arguments of a command: an experiment with its overrides or a run directory, and the command's own options."""

import pathlib
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

from agile_jax.cli.exit_codes import DONE
from agile_jax.cli.help import help_text, help_wanted
from agile_jax.cli.options import option_name, options_of, read_options, read_path
from agile_jax.experiment import Experiment, load_experiment
from agile_jax.experiment.file import KeyPath, read_table
from agile_jax.experiment.validation import dotted, validate
from agile_jax.settings import BadInput, Settings

Options = TypeVar("Options", bound=Settings)
Result = TypeVar("Result")

FILE = "EXPERIMENT.toml"
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
    takes: str = FILE,
) -> Request[Options]:
    """Parse `EXPERIMENT.toml [OPTIONS]`, or `RUN_DIR [OPTIONS]` where the command goes on in one.

    Args:
        command: for the usage line.
        model: of the command's own options.
        argv: the arguments after the command.
        default: the file that is read when none is named.
        takes: FILE or EITHER.

    Raises:
        BadInput: no experiment; or all that is wrong with the file and the options.
        SystemExit: with code 0, after --help.
    """
    usage, wanted = f"agile {command} {takes if default is None else f'[{takes}]'}", help_wanted(argv)
    named, words = _split_path(argv)
    path, run_dir = _experiment_file(named, takes) if named else (default, None)
    if path is None and wanted is None:
        raise BadInput(f"which experiment? usage: {usage} [OPTIONS]; see `agile {command} --help`")
    table = read_table(path).values if path else {}
    in_file: list[str] = []  # what is wrong there, unless an option mends it
    experiment = _try(lambda: load_experiment(path) if path else Experiment(name="experiment"), in_file)
    own, settings = list(options_of(model, {})), list(options_of(Experiment, experiment or table))
    if wanted is not None:
        print(help_text(usage, model, own, settings, wanted))
        raise SystemExit(DONE)
    errors: list[str] = []
    given, others = _try(lambda: read_options(words, [*own, *settings]), errors) or ({}, [])
    options = _try(lambda: _own_options(model, given, others), errors) if not errors else None
    overrides = {key: value for key, value in given.items() if key not in model.model_fields}
    if path and overrides:
        experiment = _try(lambda: load_experiment(path, overrides), errors)
    else:
        errors += in_file
    if experiment is None or options is None:
        raise BadInput("\n".join(errors))
    return Request(experiment, options, run_dir)


def parse_run_dir(command: str, model: type[Options], argv: Sequence[str]) -> tuple[pathlib.Path, Options]:
    """Parse `RUN_DIR [OPTIONS]`.

    Raises:
        BadInput: no run directory, or all that is wrong with the options.
        SystemExit: with code 0, after --help.
    """
    usage, own = f"agile {command} RUN_DIR", list(options_of(model, {}))
    if (wanted := help_wanted(argv)) is not None:
        print(help_text(usage, model, own, [], wanted))
        raise SystemExit(DONE)
    given, others = read_options(argv, own)
    if not others:
        raise BadInput(f"which run directory? usage: {usage} [OPTIONS]; see `agile {command} --help`")
    return read_path(others[0]), _own_options(model, given, others[1:])


def _own_options(model: type[Options], given: dict[str, object], others: list[str]) -> Options:
    if others:
        raise BadInput(f"command line: {' '.join(others)}: nothing takes this")

    def name(key: KeyPath) -> str:
        return option_name(dotted(key))

    own = {key: value for key, value in given.items() if key in model.model_fields}
    return validate(model, own, lambda key: "command line", name)


def _try(make: Callable[[], Result], errors: list[str]) -> Result | None:
    """What is made, or None and what is wrong with it."""
    try:
        return make()
    except BadInput as error:
        errors.append(str(error))
        return None


def _split_path(argv: Sequence[str]) -> tuple[pathlib.Path | None, list[str]]:
    """The experiment: the first argument, or else the first that ends in .toml."""
    for i, argument in enumerate(argv):
        if not argument.startswith("-") and (i == 0 or argument.endswith(".toml")):
            return read_path(argument), [*argv[:i], *argv[i + 1 :]]
    return None, list(argv)


def _experiment_file(named: pathlib.Path, takes: str) -> tuple[pathlib.Path, pathlib.Path | None]:
    """The file to read, and the run directory if it is that of one."""
    if takes == FILE or not named.is_dir():
        return named, None
    if not (named / "experiment.toml").is_file():
        raise BadInput(f"{named}: is a folder without an experiment.toml; name an experiment file or a run directory")
    return named / "experiment.toml", named
