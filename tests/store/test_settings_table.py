"""Every setting against every artefact: what changes when it changes. docs/settings.md shows the same table."""

import importlib.util
import pathlib
import sys

import pytest

from agile_jax.experiment import Experiment
from agile_jax.store.artefact import ARTEFACTS, EPISODES, KINEMATIC_TEST, LABELS, covered, differences, key

SCRIPT = pathlib.Path(__file__).parents[2] / "scripts" / "settings_table.py"
spec = importlib.util.spec_from_file_location("settings_table", SCRIPT)
assert spec is not None
assert spec.loader is not None
settings_table = importlib.util.module_from_spec(spec)
sys.modules["settings_table"] = settings_table
spec.loader.exec_module(settings_table)


@pytest.fixture(scope="module")
def rows() -> dict[str, dict[str, str]]:
    return settings_table.rows()


def test_the_page_in_the_docs_is_this_table(rows: dict[str, dict[str, str]]) -> None:
    page = settings_table.PAGE.read_text()
    assert page == settings_table.page(rows), "run scripts/settings_table.py, and look at what it changes"


def test_every_setting_is_in_the_table(rows: dict[str, dict[str, str]]) -> None:
    """Found by pydantic's schema, which knows nothing of the walk through the values."""
    schema = Experiment.model_json_schema()
    names = {name.rpartition(".")[2] for name in rows}
    missing = [
        f"{model}.{name}"
        for model, definition in {**schema["$defs"], "Experiment": schema}.items()
        for name, value in definition["properties"].items()
        if name not in names and name != "kind" and "$ref" not in str(value)
    ]
    assert missing == []


def column(rows: dict[str, dict[str, str]], artefact: str, effect: str) -> set[str]:
    return {name for name, effects in rows.items() if effects[artefact] == effect}


def test_what_is_known_of_the_table(rows: dict[str, dict[str, str]]) -> None:
    """The answers that were thought out, not generated."""
    nothing = {f"evaluation.{name}" for name in ("name", "batch", "where", "devices", "threads")}
    nothing |= {f"training.{name}" for name in ("checkpoint_every", "devices", "keep")}
    for name in nothing | {name for name in rows if name.startswith(("sweep.", "study."))}:
        assert set(rows[name].values()) == {""}, name
    assert column(rows, "labels", "amount") == {"dataset.trajectories"}
    assert column(rows, "episodes", "amount") == {"evaluation.episodes", "evaluation.traced"}
    assert column(rows, "kinematic-test", "amount") == {"kinematic_test.starts"}
    assert column(rows, "epochs", "amount") == {"training.epochs, with a constant rate"}
    sections = {"seed", *(name for name in rows if name.startswith(("scene.", "expert.", "dataset.")))}
    of_training = {f"dataset.{name}" for name in ("split", "split_by", "label_kind", "samples", "start_seconds")}
    assert column(rows, "labels", "key") == sections - of_training - {"dataset.trajectories"}
    solve = {name for name in sections if name.startswith(("scene.", "expert."))}
    solve -= {"scene.start.mean", "scene.start.std", "expert.initial_velocity"}
    for artefact in ("expert-times", "answers"):
        assert column(rows, artefact, "key") == solve
        assert column(rows, artefact, "amount") == set()
    for name, effects in rows.items():
        if effects["labels"]:
            assert effects["epochs"] == "key", name
        if effects["epochs"]:
            assert effects["episodes"] == effects["kinematic-test"] == "key", name
    assert rows["robot.name"] == dict.fromkeys(ARTEFACTS, "") | {"episodes": "key", "figures": "key"}
    assert rows["kinematic_test.starts"]["episodes"] == ""
    assert rows["dataset.split"]["labels"] == ""


def test_every_setting_that_an_artefact_names_exists() -> None:
    tables = Experiment(name="n").model_dump(mode="json")
    known = {name for name, _ in settings_table.leaves(Experiment(name="n"))}
    for artefact in ARTEFACTS.values():
        covered(artefact, tables)
        for name in (*artefact.without_effect, *artefact.amount, *artefact.only_grows):
            assert name in known or any(other.startswith(f"{name}.") for other in known), name
        for name, conditions in artefact.fixed_unless:
            assert {name, *conditions} <= known
        assert list(artefact.inputs) == [name for name in ARTEFACTS if name in artefact.inputs]


def test_keys_are_told_apart_by_inputs_foreign_things_and_version() -> None:
    import dataclasses

    tables = Experiment(name="n").model_dump(mode="json")
    one = key(EPISODES, tables, {"epochs": "a"})
    others = [key(EPISODES, tables, {"epochs": "b"}), key(EPISODES, tables, {"epochs": "a"}, {"robot": "c"})]
    others.append(key(dataclasses.replace(EPISODES, version=EPISODES.version + 1), tables, {"epochs": "a"}))
    assert len({one, *others}) == 4
    assert key(EPISODES, dict(reversed(tables.items())), {"epochs": "a"}) == one
    with pytest.raises(ValueError, match="has the inputs"):
        key(EPISODES, tables)
    with pytest.raises(ValueError, match="may have the foreign"):
        key(LABELS, tables, foreign={"robot": "c"})
    with pytest.raises(KeyError, match=r"there is no setting kinematic_test\.headroom"):
        covered(KINEMATIC_TEST, {name: table for name, table in tables.items() if name != "kinematic_test"})


def test_differences_name_every_leaf_with_both_values() -> None:
    there = {"a": {"b": 1, "c": [1, 2]}, "d": [{"e": 1}, {"e": 2}], "gone": True}
    asked = {"a": {"b": 2, "c": (1, 2)}, "d": [{"e": 1}, {"e": 3}], "new": None}
    assert differences(there, asked) == [
        "a.b: 1 there, 2 asked for",
        "d.1.e: 2 there, 3 asked for",
        "gone: True there, 'absent' asked for",
        "new: 'absent' there, None asked for",
    ]
    assert differences(there, there) == []
