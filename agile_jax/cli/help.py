"""The text of `agile COMMAND --help`: what is changed most often, one section, or everything."""

import inspect
import pathlib
import textwrap
from collections.abc import Iterable, Sequence
from types import NoneType
from typing import Literal, get_args, get_origin

from agile_jax.cli.options import Option, kinds_of
from agile_jax.cli.overview import COMMANDS
from agile_jax.settings import BadInput, Settings

WIDTH, INDENT = 100, 38  # of a line, and of what an option means [characters]
MOST_CHANGED = (
    "seed",
    "scene.target",
    "dataset.trajectories",
    "dataset.starts",
    "expert.nodes",
    "expert.initial_velocity",
    "expert.clearance_margin",
    "policy.kind",
    "policy.hidden_layers",
    "training.epochs",
    "training.learning_rate",
    "training.batch_size",
    "training.seeds",
    "aggregation.rounds",
    "robot.name",
    "control.mpc.friction",
    "evaluation.episodes",
    "evaluation.backend",
    "evaluation.planner",
    "report.video",
)
ALL = "all"


def help_wanted(words: Sequence[str]) -> str | None:
    """The section that `--help SECTION` or `--help-SECTION` asks for: ALL, "" for the short text, None for no help."""
    for i, word in enumerate(words):
        if word in ("-h", "--help"):
            section = words[i + 1] if i + 1 < len(words) else ""
            return "" if section.startswith("-") or section.endswith(".toml") else section
        if word.startswith("--help-"):
            return word.removeprefix("--help-")
    return None


def help_text(usage: str, model: type[Settings], own: Iterable[Option], settings: Sequence[Option], wanted: str) -> str:
    """The text that `--help` prints.

    Args:
        usage: the command with its arguments.
        model: of the command's own options; its docstring says how it is done.
        own: these options.
        settings: of the experiment; none where it reads none.
        wanted: see `help_wanted`.

    Raises:
        BadInput: there is no such section.
    """
    command = " ".join(usage.split()[:2])
    does = COMMANDS[usage.split()[1]][1]
    lines = [f"usage: {usage} [OPTIONS]", "", f"{does[:1].upper()}{does[1:]}. {inspect.getdoc(model)}", ""]
    if wanted in ("", ALL):
        lines += [line for option in own for line in _entry(option)]
    if settings and not wanted:
        lines += ["", "settings that are changed most often:"]
        lines += [line for option in settings if option.key in MOST_CHANGED for line in _entry(option)]
        lines += [
            "",
            *textwrap.wrap(
                f"`{command} --help SECTION` lists those of a section: {', '.join(_sections(settings))}.", WIDTH
            ),
        ]
        lines += [f"`{command} --help-all` lists all {len(settings)}. After a file's name, with that file's values."]
    elif settings:
        chosen = [one for one in settings if wanted == ALL or f"{one.key}.".startswith(f"{wanted}.")]
        if not chosen:
            raise BadInput(f"--help {wanted}: there is no such section; there are {', '.join(_sections(settings))}")
        lines += [*([""] if wanted == ALL else []), *(line for option in chosen for line in _entry(option))]
    return "\n".join(lines)


def _sections(settings: Sequence[Option]) -> list[str]:
    return list(dict.fromkeys(option.key.partition(".")[0] for option in settings if "." in option.key))


def _entry(option: Option) -> list[str]:
    """An option, its meaning and its value, wrapped between words."""
    name = f"  {option.name} {_form(option)}".rstrip()
    choices = ", ".join(f"{one}" for kind in option.kinds if get_origin(kind) is Literal for one in get_args(kind))
    about = option.about + (f" One of: {choices}." if choices else "") + _shown(option)
    wrapped = textwrap.wrap(about, WIDTH - INDENT, break_on_hyphens=False)
    if len(name) >= INDENT:
        return [name, *(" " * INDENT + line for line in wrapped)]
    return [f"{name:<{INDENT}}{wrapped[0] if wrapped else ''}".rstrip(), *(" " * INDENT + line for line in wrapped[1:])]


def _form(option: Option) -> str:
    """What stands behind the option's name."""
    kinds = [kind for kind in option.kinds if kind is not NoneType]
    if kinds == [bool]:
        return "[true|false]"
    arrays = [get_args(kind) for kind in kinds if get_origin(kind) is tuple]
    if arrays and option.length != 1:
        inner = [_word(kinds_of(kind)) for kind in arrays[0] if kind is not Ellipsis]
        return " ".join(inner) + ("" if option.length else " ...")
    return "TOML" if arrays or any(get_origin(kind) is dict for kind in kinds) else _word(kinds)


def _word(kinds: Iterable[object]) -> str:
    for kind in kinds:
        if get_origin(kind) is Literal:
            return "WORD"
        if isinstance(kind, type) and kind is not NoneType:
            return {"str": "TEXT", "posixpath": "PATH"}.get(kind.__name__.lower(), kind.__name__.upper())
    return "VALUE"


def _shown(option: Option) -> str:
    """The value that holds without the option; nothing where there is none."""
    value = option.value
    if value is None or value == () or type(value).__name__ == "PydanticUndefinedType":
        return ""
    if isinstance(value, bool):
        return f" [{str(value).lower()}]"
    if isinstance(value, list | tuple) and all(isinstance(item, str | int | float) for item in value):
        return f" [{' '.join(map(str, value))}]"
    return f" [{value}]" if isinstance(value, str | int | float | pathlib.Path) else ""
