"""From pydantic's errors to messages: file, dotted key, value, what is allowed, nearest valid name."""

import difflib
import math
import re
from collections.abc import Callable, Iterator
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from agile_jax.settings import BadInput

Model = TypeVar("Model", bound=BaseModel)
Where = tuple[str | int, ...]


def validate(model: type[Model], values: dict[str, Any], where_from: Callable[[Where], str]) -> Model:
    """An instance of `model`, or all errors at once.

    Args:
        model: the settings to make.
        values: plain tables, arrays and scalars.
        where_from: the file that set a key, for the message.

    Raises:
        BadInput: one line for each error.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        lines = [_describe(model, values, where_from, detail) for detail in error.errors(include_url=False)]
        raise BadInput("\n".join(dict.fromkeys(lines))) from None


def dotted(where: Where) -> str:
    """The key as written on the command line: scene.obstacles.0.position."""
    return ".".join(map(str, where))


def nested_models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model inside an annotation such as tuple[A | B, ...] | None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from nested_models(argument)


def _describe(model: type[BaseModel], values: Any, where_from: Callable[[Where], str], detail: Any) -> str:
    where, value = _locate(values, detail["loc"], detail["type"] == "missing")
    file, key = where_from(where), dotted(where)
    message = detail["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:] if message.startswith("Input") else message
    if detail["type"] == "extra_forbidden":
        known = _known_names(model, detail["loc"][:-1])
        near = difflib.get_close_matches(str(where[-1]), known, 1, 0.5)
        hint = f"did you mean {dotted((*where[:-1], near[0]))}? " if near else ""
        return f"{file}: {key}: unknown key; {hint}Known here: {', '.join(known)}"
    if detail["type"] == "missing":
        return f"{file}: {key}: is missing"
    if not where or isinstance(value, dict):
        return f"{file}: {key}: {message}" if where else f"{file}: {message}"
    hint = ""
    if isinstance(value, str):
        choices = re.findall(r"'([^']*)'", str(detail.get("ctx", {}).get("expected", "")))
        near = difflib.get_close_matches(value, choices, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
    if isinstance(value, float) and not math.isfinite(value):
        message = "must be a finite number"
    return f"{file}: {key} = {_short(value)}: {message}{hint}"


def _locate(values: Any, location: Where, missing: bool) -> tuple[Where, Any]:
    """The key path in the file, and its value. Pydantic's location also names members of unions; no file does."""
    where: list[str | int] = []
    node = values
    for i, part in enumerate(location):
        in_array = isinstance(node, list | tuple) and isinstance(part, int) and part < len(node)
        if in_array or (isinstance(node, dict) and part in node):
            node = node[part]
        elif missing and i == len(location) - 1:
            return (*where, part), None
        else:
            continue
        where.append(part)
    return tuple(where), node


def _known_names(model: type[BaseModel], location: Where) -> list[str]:
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
        candidates = below or [candidate for candidate in candidates if part in _tags(candidate)]
    return [name for candidate in candidates for name in candidate.model_fields]


def _tags(model: type[BaseModel]) -> set[str]:
    annotations = [field.annotation for field in model.model_fields.values()]
    return {tag for annotation in annotations if get_origin(annotation) is Literal for tag in get_args(annotation)}


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
