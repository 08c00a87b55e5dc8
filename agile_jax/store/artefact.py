"""What each kept result depends on: the one place that says it.

An artefact is a kind of kept thing. It names the settings that it reads, those of them without effect on it, those
that only say how much of it is wanted, the artefacts that it is made from, and what else it depends on by content,
such as a robot's compiled model. From that follow:

- its key: equal keys mean an equal result, so what is there is taken up, never made again;
- what is missing: more of an amount leaves the key as it is, so what exists is kept and the rest is made;
- the refusal of what was made with other settings, which names the differences.

Settings are plain nested tables (an experiment's `model_dump(mode="json")`), so this module imports no stage.
docs/settings.md shows every setting's effect on every artefact; tests/store/test_settings_table.py compares the two.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

from agile_jax import plugins
from agile_jax.files import hash_json

Table = Mapping[str, object]
ELSEWHERE = "elsewhere"  # the source of labels that the expert has not made (dataset/write.py)


@dataclass(frozen=True)
class Artefact:
    """A kind of kept thing. Settings are dotted: a section ("scene") or a setting in it ("scene.start").

    Attributes:
        name: of the artefact, also of its folder in a shared store.
        version: raised when the same settings give another result or another file.
        reads: the settings that the result depends on.
        without_effect: settings below `reads` on which it does not depend.
        amount: settings below `reads` that say how much is wanted; a larger amount begins with the smaller one.
        fixed_unless: when an amount is part of the key after all: by amount, the values that other settings must have.
        inputs: artefacts that it is made from, by name; their digests are part of the key.
        foreign: other things whose content is part of the key, by name: "robot", "labels" that were made elsewhere, and
            the kinds of plugins.
        only_grows: amounts of which less cannot be cut from more.
    """

    name: str
    reads: tuple[str, ...]
    version: int = 1
    without_effect: tuple[str, ...] = ()
    amount: tuple[str, ...] = ()
    fixed_unless: tuple[tuple[str, Mapping[str, object]], ...] = ()
    inputs: tuple[str, ...] = ()
    foreign: tuple[str, ...] = ()
    only_grows: tuple[str, ...] = ()


# Which samples a policy sees of the labels, and in which split.
READING = ("dataset.split", "dataset.split_by", "dataset.label_kind", "dataset.samples", "dataset.start_seconds")

LABELS = Artefact(
    "labels",
    ("seed", "scene", "expert", "dataset"),
    without_effect=READING,
    amount=("dataset.trajectories",),
    foreign=("expert", "obstacle", "labels"),
)
EXPERT_TIMES = Artefact(  # rest-to-rest solves; each start is a task with a digest of its own (store/parts.py)
    "expert-times",
    ("scene", "expert"),
    without_effect=("scene.start", "expert.initial_velocity"),
    foreign=("expert", "obstacle"),
)
ANSWERS = replace(EXPERT_TIMES, name="answers")  # solves from visited poses, the initial velocity free
EPOCHS = Artefact(
    "epochs",
    (
        "seed",
        "scene",
        "expert.velocity",
        "expert.acceleration",
        "expert.clearance_margin",
        *READING,
        "policy",
        "training",
        "kinematic_test",
        "aggregation",
    ),
    without_effect=("training.checkpoint_every", "training.devices", "training.keep", "kinematic_test.starts"),
    amount=("training.epochs",),
    fixed_unless=(
        ("training.epochs", {"training.schedule": "constant", "training.warmup": 0.0, "aggregation.rounds": 0}),
    ),
    inputs=("labels",),
    foreign=("policy", "obstacle"),
    only_grows=("training.epochs",),
)
KINEMATIC_TEST = Artefact(
    "kinematic-test",
    ("seed", "scene", "expert", "policy", "kinematic_test.starts", "kinematic_test.headroom", "kinematic_test.dt"),
    amount=("kinematic_test.starts",),
    inputs=("expert-times", "epochs"),
    foreign=("policy", "obstacle"),
)
EPISODES = Artefact(
    "episodes",
    ("seed", "scene", "expert", "policy", "robot.legs", "robot.joints", "plant", "sensors", "control", "evaluation"),
    version=3,
    without_effect=(
        "evaluation.name",
        "evaluation.batch",
        "evaluation.where",
        "evaluation.devices",
        "evaluation.threads",
    ),
    amount=("evaluation.episodes", "evaluation.traced"),
    inputs=("epochs",),
    foreign=("robot", "expert", "policy", "controller", "obstacle"),
)
FIGURES = Artefact(
    "figures",
    ("name", "scene", "expert", "policy", "robot.legs", "robot.joints", "report"),
    inputs=("labels", "epochs", "kinematic-test", "episodes"),
    foreign=("robot", "expert", "policy", "obstacle"),
)
ARTEFACTS = {one.name: one for one in (LABELS, EXPERT_TIMES, ANSWERS, EPOCHS, KINEMATIC_TEST, EPISODES, FIGURES)}


def covered(artefact: Artefact, settings: Table) -> dict[str, object]:
    """The settings that the key covers, by dotted path: for records, and to name differences.

    Raises:
        KeyError: a setting that the artefact names does not exist.
    """
    return _below(settings, artefact.reads, {*artefact.without_effect, *_free_amounts(artefact, settings)})


def amounts(artefact: Artefact, settings: Table) -> dict[str, object]:
    """How much of the artefact the settings ask for, by dotted setting."""
    return _below(settings, _free_amounts(artefact, settings))


def key(
    artefact: Artefact,
    settings: Table,
    inputs: Mapping[str, str] | None = None,
    foreign: Mapping[str, str] | None = None,
) -> str:
    """The sha256 that names the result, whatever its amount.

    Args:
        artefact: what is kept.
        settings: all of an experiment's settings, as nested tables.
        inputs: the digest of each artefact that it is made from.
        foreign: digests of what else it depends on; those of plugins that the settings name are found here.

    Raises:
        ValueError: an input is missing, or an input or foreign thing is unknown.
    """
    given = dict(inputs or {})
    named = {kind: digest for kind, digest in plugins.digests(settings).items() if kind in artefact.foreign}
    strange = named | dict(foreign or {})
    if given.keys() != set(artefact.inputs) or not strange.keys() <= set(artefact.foreign):
        raise ValueError(
            f"{artefact.name} has the inputs {list(artefact.inputs)} and may have the foreign "
            f"{list(artefact.foreign)}, not {sorted(given)} and {sorted(strange)}"
        )
    content = {"artefact": artefact.name, "version": artefact.version, "settings": covered(artefact, settings)}
    return hash_json(content | {"inputs": given, "foreign": strange})


def described(artefact: Artefact, settings: Table) -> dict[str, object]:
    """All settings that decide on the result, by dotted path, those of its inputs and their amounts too: what a record
    tells, and what a refusal compares.
    """
    found: dict[str, object] = {}
    for source in (ARTEFACTS[name] for name in artefact.inputs):
        found |= described(source, settings) | amounts(source, settings)
    return found | covered(artefact, settings)


def keys(settings: Table, foreign: Mapping[str, str] | None = None) -> dict[str, str]:
    """The key of every artefact, with (key, amount) of its inputs in place of their digests: what depends on what,
    known before anything is made.
    """
    found: dict[str, str] = {}
    whole: dict[str, str] = {}
    for name, artefact in ARTEFACTS.items():
        strange = {which: digest for which, digest in (foreign or {}).items() if which in artefact.foreign}
        found[name] = key(artefact, settings, {which: whole[which] for which in artefact.inputs}, strange)
        whole[name] = hash_json([found[name], amounts(artefact, settings)])
    return found


def differences(there: object, asked: object) -> list[str]:
    """The dotted settings in which two tables differ, nested or flat, with both values, one a line."""
    old, new = dict(_leaves(there)), dict(_leaves(asked))
    names = [name for name in dict.fromkeys([*old, *new]) if old.get(name, "absent") != new.get(name, "absent")]
    return [f"{name}: {old.get(name, 'absent')!r} there, {new.get(name, 'absent')!r} asked for" for name in names]


def _free_amounts(artefact: Artefact, settings: Table) -> tuple[str, ...]:
    """The amounts that are no part of the key with these settings."""
    values, conditions = dict(_leaves(settings)), dict(artefact.fixed_unless)
    return tuple(
        amount
        for amount in artefact.amount
        if all(values[other] == value for other, value in conditions.get(amount, {}).items())
    )


def _below(settings: Table, names: Collection[str], left_out: Collection[str] = ()) -> dict[str, object]:
    """The values of settings and of all in sections, by dotted path, without those that are left out.

    Raises:
        KeyError: there is no such setting.
    """
    leaves = dict(_leaves(settings))
    for name in names:
        if name not in left_out and not any(_within(dotted, (name,)) for dotted in leaves):
            raise KeyError(f"there is no setting {name}")
    return {name: value for name, value in leaves.items() if _within(name, names) and not _within(name, left_out)}


def _within(dotted: str, names: Collection[str]) -> bool:
    """Whether a setting is one of these, or in one of these sections."""
    return any(f"{dotted}.".startswith(f"{name}.") for name in names)


def _leaves(value: object, dotted: str = "") -> Iterator[tuple[str, object]]:
    """Every value that is no table, by its dotted path; arrays of tables are walked through, others are one value."""
    if isinstance(value, Mapping) and value:
        for name, item in value.items():
            yield from _leaves(item, f"{dotted}.{name}" if dotted else str(name))
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        for i, item in enumerate(value):
            yield from _leaves(item, f"{dotted}.{i}" if dotted else str(i))
    else:
        yield dotted, list(value) if isinstance(value, tuple) else value
