"""Options of the command line: every field of a settings model is one, by its dotted key.

Here a value is only read, as a number, a word or an array. Whether it is allowed is judged by the model, so that a
value is judged alike wherever it is written.
"""

import difflib
import pathlib
import tomllib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from types import NoneType
from typing import Annotated, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel

from agile_jax.experiment.validation import nested_models, tags
from agile_jax.settings import BadInput


class Option(NamedTuple):
    """A field of a settings model."""

    key: str  # dotted: "training.learning_rate"
    kinds: frozenset[object]  # every type in its annotation: {tuple, float, NoneType}; dict for arrays of arrays, too
    choices: tuple[object, ...]  # the words that are allowed; none where others are
    about: str  # meaning and unit
    value: object  # that holds where the option is not given

    @property
    def takes_text(self) -> bool:
        """Whether a word is kept as it is written."""
        return bool(self.choices) or bool(self.kinds & {str, pathlib.Path})


def option_name(key: str) -> str:
    """The option of a dotted key: --training.learning-rate."""
    return "--" + key.replace("_", "-")


def options_of(model: type[BaseModel], held: BaseModel | Mapping[str, object], prefix: str = "") -> Iterator[Option]:
    """The options of a model and of the models in it.

    Args:
        model: of the settings.
        held: their values, or a table that is not valid yet.
        prefix: of the keys.
    """
    for name, field in model.model_fields.items():
        value = getattr(held, name) if isinstance(held, BaseModel) else held.get(name, field.get_default())
        key, models = f"{prefix}{name}", list(nested_models(field.annotation))
        if isinstance(value, BaseModel) or (isinstance(value, Mapping) and models):
            yield from options_of(type(value) if isinstance(value, BaseModel) else models[0], value, f"{key}.")
            continue
        for i, item in enumerate(value if models and isinstance(value, list | tuple) else ()):
            kind = getattr(item, "kind", item.get("kind") if isinstance(item, Mapping) else None)
            for own in [type(item)] if isinstance(item, BaseModel) else [one for one in models if kind in tags(one)]:
                yield from options_of(own, item, f"{key}.{i}.")
        parts = list(_parts(field.annotation))
        kinds = frozenset(part for part in parts if isinstance(part, type)) | (
            {dict} if parts.count(tuple) > 1 else set()
        )
        choices = tuple(word for part in parts if get_origin(part) is Literal for word in get_args(part))
        yield Option(key, kinds, choices, " ".join((field.description or "").split()), value)


def _parts(annotation: object) -> Iterator[object]:
    """Every type in an annotation, and its literals: tuple, float of Annotated[tuple[float, ...], ...]."""
    origin = get_origin(annotation)
    yield origin if isinstance(origin, type) else annotation
    for part in get_args(annotation)[: 1 if origin is Annotated else None] if origin is not Literal else ():
        yield from _parts(part)


def read_options(words: Iterable[str], options: Iterable[Option]) -> tuple[dict[str, object], list[str]]:
    """The given values by dotted key; and what is wrong: unknown options, values that are missing or cannot be read."""
    known = {option.key: option for option in options}
    waiting, given, errors = deque(words), dict[str, object](), list[str]()
    while waiting:
        written, equals, value = waiting.popleft().partition("=")
        values = [value] if equals else []
        while not equals and waiting and not waiting[0].startswith("--"):
            values.append(waiting.popleft())
        key = written[2:].replace("-", "_")
        positive = key.replace(".no_", ".").removeprefix("no_")
        if not written.startswith("--"):
            errors.append(f"{written}: nothing takes this; options begin with --")
        elif key in known:
            try:
                given[key] = _read(known[key], values)
            except BadInput as error:
                errors.append(f"{written}{error}")
        elif positive in known and bool in known[positive].kinds and not values:
            given[positive] = False
        else:
            near = difflib.get_close_matches(key, known, 1)
            errors.append(f"{written}: unknown option" + (f"; did you mean {option_name(near[0])}?" if near else ""))
    return given, errors


def _read(option: Option, words: list[str]) -> object:
    if not words and bool in option.kinds:
        return True
    if not words or (len(words) > 1 and tuple not in option.kinds):
        raise BadInput(f": needs {'a value' if not words else f'one value, not {len(words)}'}")
    if NoneType in option.kinds and words in (["None"], ["none"]):
        return None
    if words[0].startswith(("[", "{")) and not option.kinds.isdisjoint({tuple, dict}):
        try:
            return tomllib.loads(f"value = {' '.join(words)}")["value"]
        except tomllib.TOMLDecodeError as error:
            raise BadInput(f" = {' '.join(words)}: cannot be read as TOML ({error})") from None
    if dict in option.kinds:
        raise BadInput(": is written as in a file, in quotes: '[[1.0, 2.0], [3.0, 4.0]]'")
    if pathlib.Path in option.kinds:
        return read_path(words[0])
    values = words if option.takes_text else [_number(word) for word in words]
    return values if tuple in option.kinds else values[0]


def _number(word: str) -> object:
    for number in (int, float):
        try:
            return number(word)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(word.lower(), word)


def read_path(word: str) -> pathlib.Path:
    """A path as a shell would have it: `~` is the home directory, also where the shell left it alone.

    Raises:
        BadInput: there is no home directory.
    """
    try:
        return pathlib.Path(word).expanduser()
    except RuntimeError:
        raise BadInput(f" {word}: there is no home directory; write the whole path") from None
