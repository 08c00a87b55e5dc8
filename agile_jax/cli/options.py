"""Options of the command line: every field of a settings model is one, by its dotted key.

Here a value is only read, as a number, a word or an array. Whether it is allowed is judged by the model, so that a
value is judged alike wherever it is written.
"""

import difflib
import pathlib
import tomllib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from types import NoneType, UnionType
from typing import Annotated, Literal, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel

from agile_jax.experiment.validation import nested_models, tags
from agile_jax.settings import BadInput


class Option(NamedTuple):
    """A field of a settings model."""

    key: str  # dotted: "training.learning_rate"
    kinds: tuple[object, ...]  # the members of its type without annotations: (float, NoneType)
    about: str  # meaning and unit
    value: object  # that holds where the option is not given

    @property
    def name(self) -> str:
        """The option as it is written: --training.learning-rate."""
        return option_name(self.key)

    @property
    def length(self) -> int | None:
        """The number of words that its value takes; None for an array of any length."""
        arrays = [get_args(kind) for kind in self.kinds if get_origin(kind) is tuple]
        if not arrays or any(get_origin(bare) is tuple for kind in arrays[0] for bare in kinds_of(kind)):
            return 1
        return None if arrays[0][-1] is Ellipsis else len(arrays[0])


def option_name(key: str) -> str:
    """The option of a dotted key."""
    return "--" + key.replace("_", "-")


def kinds_of(annotation: object) -> tuple[object, ...]:
    """The members of a type such as Annotated[float | None, ...]."""
    if get_origin(annotation) is Annotated:
        return kinds_of(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return tuple(kind for member in get_args(annotation) for kind in kinds_of(member))
    return (annotation,)


def options_of(model: type[BaseModel], held: BaseModel | Mapping[str, object], prefix: str = "") -> Iterator[Option]:
    """The options of a model and of the models in it.

    Args:
        model: of the settings.
        held: their values, or a table that is not valid yet.
        prefix: of the keys.
    """
    for name, field in model.model_fields.items():
        value = getattr(held, name) if isinstance(held, BaseModel) else held.get(name, field.get_default())
        key = f"{prefix}{name}"
        if isinstance(value, BaseModel):
            yield from options_of(type(value), value, f"{key}.")
            continue
        models = list(nested_models(field.annotation))
        if isinstance(value, Mapping) and models:
            yield from options_of(models[0], value, f"{key}.")
            continue
        for i, item in enumerate(value if models and isinstance(value, list | tuple) else ()):
            if isinstance(item, BaseModel):
                yield from options_of(type(item), item, f"{key}.{i}.")
            elif isinstance(item, Mapping) and (own := [one for one in models if item.get("kind") in tags(one)]):
                yield from options_of(own[0], item, f"{key}.{i}.")
        yield Option(key, kinds_of(field.annotation), " ".join((field.description or "").split()), value)


def read_options(words: Iterable[str], options: Iterable[Option]) -> tuple[dict[str, object], list[str]]:
    """The given values by dotted key, and the words that belong to no option.

    Raises:
        BadInput: all unknown options and all values that are missing or cannot be read.
    """
    known = {option.key: option for option in options}
    waiting, errors = deque(words), list[str]()
    given, others = dict[str, object](), list[str]()
    while waiting:
        word = waiting.popleft()
        if not word.startswith("--"):
            others.append(word)
            continue
        written, equals, value = word.partition("=")
        key = written[2:].replace("-", "_")
        above, _, last = key.rpartition(".")
        positive = f"{above}.{last[3:]}" if above else last[3:]
        if last.startswith("no_") and positive in known and bool in known[positive].kinds:
            given[positive] = False
        elif key not in known:
            near = difflib.get_close_matches(key, known, 1)
            errors.append(f"{written}: unknown option" + (f"; did you mean {option_name(near[0])}?" if near else ""))
            while waiting and not waiting[0].startswith("--"):
                waiting.popleft()
        else:
            try:
                given[key] = _read(known[key], [value] if equals else _take(waiting, known[key]))
            except BadInput as error:
                errors.append(str(error))
    if errors:
        raise BadInput("\n".join(errors))
    return given, others


def _take(waiting: deque[str], option: Option) -> list[str]:
    """The words that are the option's value."""
    if option.kinds == (bool,):
        return [waiting.popleft()] if waiting and waiting[0].lower() in ("true", "false") else ["true"]
    taken: list[str] = []
    while waiting and not waiting[0].startswith("--") and len(taken) != option.length:
        if option.length is None and taken and waiting[0].endswith(".toml"):
            break
        taken.append(waiting.popleft())
        if taken[0].startswith(("[", "{")):
            break
    return taken


def _read(option: Option, words: list[str]) -> object:
    if not words:
        raise BadInput(f"{option.name}: needs a value")
    first = words[0]
    if len(words) == 1 and NoneType in option.kinds and first.lower() == "none":
        return None
    if len(words) == 1 and first.startswith(("[", "{")) and not _takes_text(option.kinds):
        try:
            return tomllib.loads(f"value = {first}")["value"]
        except tomllib.TOMLDecodeError as error:
            raise BadInput(f"{option.name} = {first}: cannot be read as TOML ({error})") from None
    if option.length == 1:
        return _scalar(option.name, first, option.kinds)
    array = next(kind for kind in option.kinds if get_origin(kind) is tuple)
    inner = tuple(kind for member in get_args(array) if member is not Ellipsis for kind in kinds_of(member))
    return [_scalar(option.name, word, inner) for word in words]


def _takes_text(kinds: tuple[object, ...]) -> bool:
    return any(kind is str or get_origin(kind) is Literal for kind in kinds)


def _scalar(name: str, word: str, kinds: tuple[object, ...]) -> object:
    if pathlib.Path in kinds:
        return read_path(word, name)
    if _takes_text(kinds):
        return word
    for number in (int, float):
        try:
            return number(word)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(word.lower(), word)


def read_path(word: str, name: str = "") -> pathlib.Path:
    """A path as a shell would have it: `~` is the home directory, also where the shell left it alone.

    Raises:
        BadInput: there is no home directory.
    """
    try:
        return pathlib.Path(word).expanduser()
    except RuntimeError:
        raise BadInput(
            f"{f'{name} = ' if name else ''}{word}: there is no home directory; write the whole path"
        ) from None
