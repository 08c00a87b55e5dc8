"""docs/settings.md: what each setting of an experiment changes in what is kept. Run: scripts/settings_table.py

Every setting is changed, one at a time, to another valid value, and the keys of all artefacts (store/artefact.py) are
compared before and after. tests/store/test_settings_table.py compares the committed page with this one.
"""

import pathlib
import typing
from collections.abc import Iterator, Mapping

from pydantic import BaseModel

from agile_jax.experiment import Experiment
from agile_jax.settings import BadInput
from agile_jax.store.artefact import ARTEFACTS, amounts, keys

PAGE = pathlib.Path(__file__).parents[1] / "docs" / "settings.md"
TABLE = {"kind": "table", "position": (1.5, 0.0), "size": (0.5, 1.0), "underside": 0.25, "leg_size": (0.05, 0.05)}
BOX = {"kind": "box", "position": (1.0, 2.0, 0.3), "size": (0.2, 0.2, 0.2)}
BASE = {
    "name": "base",
    "scene": {
        "obstacles": (TABLE, BOX),
        "crouch": {"by": "hand", "heights": (0.155, 0.18), "speeds": (0.9, 1.2)},
    },
    "sweep": {"space": {"training.learning_rate": (1e-3, 2e-3)}},
    "study": {"vary": "seed", "values": (1, 2)},
}
WITH: dict[str, dict[str, object]] = {  # what other settings must be for one to have another valid value
    "training.momentum": {"training.optimizer": "sgd"},
    "training.nesterov": {"training.optimizer": "sgd", "training.momentum": 0.5},
    "training.weight_decay": {"training.optimizer": "adamw"},
    "training.patience": {"training.select": "best"},
    "aggregation.rounds": {"expert.initial_velocity": "free"},
    "dataset.label_kind": {"policy.kind": "plain"},
    "evaluation.physics.rotor_reaction": {"evaluation.backend": "pybullet"},
    "training.output_units": {"policy.kind": "plain"},
}
EFFECT = {"": "–", "key": "anew", "amount": "grows"}
HEAD = """# What each setting changes

- *anew*: the artefact has another key, so it is made anew. What is there is refused, moved aside or
  kept beside it, never mixed.
- *grows*: the key stays. What exists is kept, what is missing is made.
- *–*: nothing.

An artefact is also made anew when one that it is made from changes. Expert times and answers are
kept by start: what decides on the starts (the seed, `scene.start`) asks for others and keeps those
that are there. Of `robot.name` the compiled model counts, not the path. The table holds for a
`scene.crouch` given by hand; where the legs give it, its numbers follow from robot and gait.
`scripts/settings_table.py` makes this page, and a test compares the two.
"""


def leaves(value: object, dotted: str = "") -> Iterator[tuple[str, object]]:
    """Every setting with its value, by dotted path; obstacles by their number."""
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from leaves(getattr(value, name), f"{dotted}.{name}" if dotted else name)
    elif isinstance(value, tuple) and value and all(isinstance(item, BaseModel) for item in value):
        for i, item in enumerate(value):
            yield from leaves(item, f"{dotted}.{i}")
    else:
        yield dotted, value


def others(value: object, annotation: object) -> Iterator[object]:
    """Other values of the same kind, some of which may not be valid."""
    yield from (choice for choice in choices(annotation) if choice != value)
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int):
        yield from (value + 1, value - 1, 2 * value)
    elif isinstance(value, float):
        yield from (value * 1.05, value * 0.95, value + 0.01, value / 2)
    elif isinstance(value, str):
        yield value + "x"
    elif value is None:
        yield from (1, 1.0, (0.05, 0.05), "another")
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            for other in others(item, None):
                yield (*value[:i], other, *value[i + 1 :])
        if len(value) > 1:
            yield (value[0] - 0.1, value[1] + 0.1, *value[2:]) if isinstance(value[0], float) else value[::-1]
        yield ((3.0, 0.0, 0.28, 0.0),)


def choices(annotation: object) -> tuple[object, ...]:
    """The values of a Literal, wherever it stands in an annotation."""
    if typing.get_origin(annotation) is typing.Literal:
        return typing.get_args(annotation)
    return tuple(choice for inner in typing.get_args(annotation) for choice in choices(inner))


def changed(tables: Mapping[str, object], dotted: str, value: object) -> dict[str, object]:
    """The tables with one setting changed."""
    name, _, rest = dotted.partition(".")
    below = tables[name]
    if not rest:
        return {**tables, name: value}
    if isinstance(below, Mapping):
        return {**tables, name: changed(below, rest, value)}
    assert isinstance(below, list | tuple)
    number, _, rest = rest.partition(".")
    items = [changed(item, rest, value) if i == int(number) else item for i, item in enumerate(below)]
    return {**tables, name: items}


def annotation_of(model: BaseModel, dotted: str) -> object:
    """The annotation of a setting."""
    *above, last = dotted.split(".")
    node: object = model
    for name in above:
        node = node[int(name)] if isinstance(node, tuple) else getattr(node, name)
    field = type(node).model_fields.get(last) if isinstance(node, BaseModel) else None
    if field is None:
        return None
    return typing.Literal[tuple(field.examples)] if field.examples else field.annotation


def variants(base: Experiment, dotted: str) -> tuple[dict[str, object], dict[str, object]]:
    """Tables of an experiment, and of another that differs from it in this setting alone.

    Raises:
        LookupError: no other valid value was found: say in WITH what it needs.
    """
    tables = base.model_dump(mode="json")
    for other, value in WITH.get(dotted, {}).items():
        tables = changed(tables, other, value)
    before = Experiment.model_validate(tables)
    value = dict(leaves(before))[dotted]
    for other in others(value, annotation_of(before, dotted)):
        try:
            after = Experiment.model_validate(changed(before.model_dump(mode="json"), dotted, other))
        except (ValueError, TypeError, BadInput):
            continue
        if dict(leaves(after))[dotted] != value:
            return before.model_dump(mode="json"), after.model_dump(mode="json")
    if dotted.startswith(("sweep.", "study.")) or len(choices(annotation_of(before, dotted))) == 1:
        # Of a sweep or a study, two settings must change at once; where there is one choice, the others are plugins.
        tables = before.model_dump(mode="json")
        return tables, changed(tables, dotted, "another")
    raise LookupError(f"{dotted}: no other valid value found beside {value!r}")


def effects(before: Mapping[str, object], after: Mapping[str, object], robot: str = "") -> dict[str, str]:
    """What becomes of each artefact: "key", "amount" or ""."""
    old, new = keys(before), keys(after, {"robot": robot} if robot else None)
    return {
        name: "key" if old[name] != new[name] else "amount" if amounts(one, before) != amounts(one, after) else ""
        for name, one in ARTEFACTS.items()
    }


def rows() -> dict[str, dict[str, str]]:
    """The effects of every setting by its dotted path; epochs once more for a constant rate."""
    base = Experiment.model_validate(BASE)
    found = {}
    for dotted, _ in leaves(base):
        if dotted == "robot.name":  # its file is read; another compiled model stands for it
            tables = base.model_dump(mode="json")
            found[dotted] = effects(tables, tables, robot="another model")
        elif not dotted.endswith(".kind") or not dotted.startswith("scene."):
            found[dotted] = effects(*variants(base, dotted))
    constant = Experiment.model_validate(changed(base.model_dump(mode="json"), "training.schedule", "constant"))
    found["training.epochs, with a constant rate"] = effects(*variants(constant, "training.epochs"))
    return found


def page(table: Mapping[str, Mapping[str, str]]) -> str:
    """The page of `rows()`."""
    lines = [HEAD, f"| setting | {' | '.join(ARTEFACTS)} |", "|---" * (1 + len(ARTEFACTS)) + "|"]
    for dotted, effect in table.items():
        shown = dotted.replace("obstacles.0.", "obstacles (table) ").replace("obstacles.1.", "obstacles (box) ")
        lines.append(f"| `{shown}` | {' | '.join(EFFECT[effect[name]] for name in ARTEFACTS)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(rows()))
