"""The text of `agile COMMAND --help`: what is changed most often, one section, or everything."""

import pathlib
import textwrap
from collections.abc import Iterable, Sequence

from agile_jax.cli.options import Option, option_name
from agile_jax.cli.overview import COMMANDS
from agile_jax.settings import BadInput

WIDTH, INDENT = 100, 38  # of a line, and of what an option means [characters]
ALL = "all"
MOST_CHANGED = {
    *("seed", "scene.target", "robot.name", "control.mpc.friction", "aggregation.rounds", "report.video"),
    *("dataset.trajectories", "dataset.starts", "expert.nodes", "expert.initial_velocity", "expert.clearance_margin"),
    *("policy.kind", "policy.hidden_layers", "training.epochs", "training.learning_rate", "training.batch_size"),
    *("training.seeds", "evaluation.episodes", "evaluation.backend", "evaluation.planner"),
}


def help_wanted(words: Sequence[str]) -> str | None:
    """What `--help SECTION` or `--help-SECTION` asks for: ALL, "" for the short text, None for no help."""
    for i, word in enumerate(words):
        if word in ("-h", "--help"):
            section = words[i + 1] if i + 1 < len(words) else ""
            return "" if section.startswith("-") or section.endswith(".toml") else section
        if word.startswith("--help-"):
            return word.removeprefix("--help-")
    return None


def help_text(usage: str, own: Iterable[Option], settings: Sequence[Option], wanted: str) -> str:
    """The text that `--help` prints.

    Args:
        usage: the command with its arguments.
        own: options of the command.
        settings: of the experiment; none where it reads none.
        wanted: see `help_wanted`.

    Raises:
        BadInput: there is no such section.
    """
    words = [word for word in usage.split() if word.islower()]  # its arguments are in capitals
    command, does = " ".join(words), COMMANDS[words[1]][1]
    sections = ", ".join(dict.fromkeys(one.key.partition(".")[0] for one in settings if "." in one.key))
    lines = [f"usage: {usage} [OPTIONS]", "", f"{does[:1].upper()}{does[1:]}.", ""]
    lines += [line for one in own if wanted in ("", ALL) for line in _entry(one)]
    if not settings:
        return "\n".join(lines)
    if not wanted:
        lines += ["", "settings that are changed most often:"]
        lines += [line for one in settings if one.key in MOST_CHANGED for line in _entry(one)]
        lines += ["", *textwrap.wrap(f"`{command} --help SECTION` lists those of a section: {sections}.", WIDTH)]
        return "\n".join([*lines, f"`{command} --help-all` lists all {len(settings)}."])
    chosen = [one for one in settings if wanted == ALL or f"{one.key}.".startswith(f"{wanted}.")]
    if not chosen:
        raise BadInput(f"--help {wanted}: there is no such section; there are {sections}")
    return "\n".join([*lines, *(line for one in chosen for line in _entry(one))])


def _entry(option: Option) -> list[str]:
    """An option, its meaning and its value, wrapped between words."""
    words = {dict: " TOML", bool: "", int: " INT", float: " FLOAT", pathlib.Path: " PATH"}
    form = next((word for kind, word in words.items() if kind in option.kinds), " WORD")
    name = f"  {option_name(option.key)}{form}{' ...' if tuple in option.kinds and dict not in option.kinds else ''}"
    values = option.value if isinstance(option.value, list | tuple) else [option.value]
    shown = " ".join(str(value) for value in values if isinstance(value, str | int | float | pathlib.Path))
    about = option.about + (f" One of: {', '.join(map(str, option.choices))}." if option.choices else "")
    wrapped = textwrap.wrap(about + (f" [{shown}]" if shown else ""), WIDTH - INDENT, break_on_hyphens=False)
    first = [name] if len(name) >= INDENT else [f"{name:<{INDENT}}{wrapped.pop(0)}"]
    return first + [" " * INDENT + line for line in wrapped]
