"""From pydantic's errors to messages: file, dotted key, value, what is allowed, nearest valid name."""

import difflib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Literal, NamedTuple, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from agile_jax.experiment.check import ContradictionsError
from agile_jax.experiment.file import KeyPath
from agile_jax.settings import BadInput

Model = TypeVar("Model", bound=BaseModel)


def dotted(key: KeyPath) -> str:
    """The key as written in an override: scene.obstacles.0.position."""
    return ".".join(map(str, key))


def validate(
    model: type[Model],
    values: Mapping[str, object],
    origin: Callable[[KeyPath], str],
    name: Callable[[KeyPath], str] = dotted,
) -> Model:
    """An instance of `model`, or all errors at once.

    Args:
        model: the settings to make.
        values: plain tables, arrays and scalars.
        origin: the file that set a key, for the message.
        name: what the message calls a key.

    Raises:
        BadInput: one line for each error.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        details, lines = error.errors(include_url=False), []
        # Of an array that is too short every missing element is an error; the last one tells how long it must be.
        lengths = {detail["loc"][:-1]: detail["loc"][-1] for detail in details if detail["type"] == "missing"}
        for detail in details:
            cause = detail.get("ctx", {}).get("error")
            if isinstance(cause, ContradictionsError):
                lines += [f"{origin(one.key)}: {one.text}" for one in cause.found]
            else:
                place = _locate(values, detail["loc"], missing=detail["type"] == "missing")
                lines.append(
                    f"{origin(place.key)}: {_describe(model, place, detail, name, lengths.get(detail['loc'][:-1]))}"
                )
        raise BadInput("\n".join(dict.fromkeys(lines))) from None


def nested_models(annotation: object) -> Iterator[type[BaseModel]]:
    """Every model inside an annotation such as tuple[A | B, ...] | None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from nested_models(argument)


class _Place(NamedTuple):
    """Where an error is in the file. Pydantic's location also names members of unions; no file does."""

    key: KeyPath
    value: object
    around: object  # the table or array that holds it


def _locate(values: object, location: tuple[int | str, ...], missing: bool) -> _Place:
    key: list[str | int] = []
    node = around = values
    for i, part in enumerate(location):
        in_array = isinstance(node, list | tuple) and isinstance(part, int) and part < len(node)
        if in_array or (isinstance(node, Mapping) and part in node):
            around, node = node, node[part]  # type: ignore[index]
        elif missing and i == len(location) - 1:
            around, node = node, None
        else:
            continue
        key.append(part)
    return _Place(tuple(key), node, around)


def _describe(
    model: type[BaseModel],
    place: _Place,
    detail: ErrorDetails,
    name: Callable[[KeyPath], str],
    last_missing: int | str | None,
) -> str:
    """Key, value, what is allowed."""
    key, value = place.key, place.value
    message = detail["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:] if message.startswith("Input") else message
    hint = ""
    if detail["type"] == "extra_forbidden":
        known = _known_names(model, detail["loc"][:-1])
        near = difflib.get_close_matches(str(key[-1]), known, 1, 0.5)
        hint = f"did you mean {name((*key[:-1], near[0]))}? " if near else ""
        return f"{name(key)}: unknown key; {hint}Known here: {', '.join(known)}"
    if detail["type"] == "missing":
        if isinstance(place.around, list | tuple) and isinstance(last_missing, int):
            there = list(place.around)
            return f"{name(key[:-1])} = {_short(there)}: must have {last_missing + 1} values, not {len(there)}"
        return f"{name(key)}: is missing"
    if not key or isinstance(value, Mapping):
        return f"{name(key)}: {message}" if key else message
    if isinstance(value, str):
        choices = re.findall(r"'([^']*)'", str(detail.get("ctx", {}).get("expected", "")))
        near = difflib.get_close_matches(value, choices, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
    if detail["type"] == "too_long" and isinstance(value, list | tuple):
        message = f"must have {detail['ctx']['max_length']} values, not {len(value)}"
    if isinstance(value, float) and not math.isfinite(value):
        message = "must be a finite number"
    return f"{name(key)} = {_short(value)}: {message}{hint}"


def _known_names(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """The valid keys at a location, where a part of it may be the tag of a union's member."""
    candidates: list[type[BaseModel]] = [model]
    for part in location:
        if isinstance(part, int):
            continue
        below = [
            inner
            for candidate in candidates
            if part in candidate.model_fields
            for inner in nested_models(candidate.model_fields[part].annotation)
        ]
        candidates = below or [candidate for candidate in candidates if part in tags(candidate)]
    return [name for candidate in candidates for name in candidate.model_fields]


def tags(model: type[BaseModel]) -> set[str]:
    """The words that tell a model from the others of a union."""
    annotations = [field.annotation for field in model.model_fields.values()]
    return {tag for annotation in annotations if get_origin(annotation) is Literal for tag in get_args(annotation)}


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
