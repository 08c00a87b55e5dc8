"""Experiment files: inheritance, overrides, hashes, and what a bad one is told."""

import json
import math
import pathlib
import tomllib
from collections.abc import Callable

import pytest
from pydantic import BaseModel

from agile_jax.experiment import (
    Experiment,
    experiment_hash,
    json_schema,
    load_experiment,
    to_toml,
    with_overrides,
)
from agile_jax.experiment.moved import MOVED
from agile_jax.experiment.validation import nested_models
from agile_jax.settings import BadInput

SHIPPED = sorted((pathlib.Path(__file__).parents[1] / "experiments").glob("*.toml"))
TABLE = '[[scene.obstacles]]\nkind = "table"\nposition = [1.5, 0.0]\nsize = [0.5, 1.0]\nunderside = 0.25\n'

Write = Callable[..., pathlib.Path]


@pytest.fixture
def write(tmp_path: pathlib.Path) -> Write:
    def write(text: str, name: str = "a.toml") -> pathlib.Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def message(path: pathlib.Path, overrides: dict | None = None) -> str:
    with pytest.raises(BadInput) as caught:
        load_experiment(path, overrides)
    return str(caught.value)


def test_a_name_is_enough(write: Write) -> None:
    assert load_experiment(write('name = "n"')) == Experiment(name="n")


def test_tables_merge_and_arrays_replace(write: Write) -> None:
    write(
        'name = "base"\nseed = 3\n[training]\nepochs = 7\nlearning_rate = 0.5\n[policy]\nhidden_layers = [8, 8]\n'
        + TABLE
    )
    child = write('extends = "a.toml"\nname = "c"\n[training]\nepochs = 2\n[policy]\nhidden_layers = [4]', "c.toml")
    experiment = load_experiment(child)
    assert (experiment.name, experiment.seed) == ("c", 3)
    assert (experiment.training.epochs, experiment.training.learning_rate) == (2, 0.5)
    assert experiment.policy.hidden_layers == (4,)
    assert len(experiment.scene.obstacles) == 1
    without = write('extends = "../' + child.parent.name + '/a.toml"\n[scene]\nobstacles = []', "d.toml")
    assert load_experiment(without).scene.obstacles == ()


def test_overrides_win_and_reach_into_arrays(write: Write) -> None:
    path = write('name = "n"\n[training]\nepochs = 7\n' + TABLE)
    experiment = load_experiment(path, {"training.epochs": 3, "scene.obstacles.0.underside": 0.3, "robot.name": "a1"})
    assert experiment.training.epochs == 3
    assert experiment.scene.obstacles[0].underside == 0.3
    assert with_overrides(experiment, {"training.epochs": 4}, "here").training.epochs == 4
    assert experiment.training.epochs == 3


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_experiments_load_and_survive_writing(path: pathlib.Path, write: Write) -> None:
    experiment = load_experiment(path)
    assert experiment.name == path.stem
    again = load_experiment(write(to_toml(experiment)))
    assert again == experiment
    assert experiment_hash(again) == experiment_hash(experiment)


def test_the_paper_is_the_paper() -> None:
    paper = load_experiment(next(path for path in SHIPPED if path.stem == "paper"))
    assert paper.dataset.trajectories == 10_000
    assert (paper.expert.initial_velocity, paper.dataset.starts) == ("rest", "paper")
    assert paper.policy.kind == "plain"
    assert paper.policy.hidden_layers == (256, 1024, 1024, 1024, 1024, 256)
    training = paper.training
    assert (training.optimizer, training.learning_rate, training.batch_size, training.epochs) == ("sgd", 0.5, 1024, 20)
    assert paper.dataset.split == (0.8, 0.1, 0.1)


def test_no_default_is_lost_for_want_of_a_null_in_toml() -> None:
    """An optional setting must default to None: written files leave None out."""
    models: list[type[BaseModel]] = [Experiment]
    for model in models:
        for field in model.model_fields.values():
            if type(None) in getattr(field.annotation, "__args__", ()):
                assert field.default is None
            models.extend(inner for inner in nested_models(field.annotation) if inner not in models)
    assert len(models) > 10


def test_the_hash_of_an_experiment_is_that_of_its_canonical_json() -> None:
    import hashlib

    experiment = Experiment(name="n", seed=5)
    tables = experiment.model_dump(mode="json", exclude={"name", "sweep", "study"})
    text = json.dumps(dict(reversed(tables.items())), sort_keys=True, separators=(",", ":"))
    assert experiment_hash(experiment) == hashlib.sha256(text.encode()).hexdigest()
    assert experiment_hash(experiment) == experiment_hash(with_overrides(experiment, {"name": "m"}, "test"))


def test_an_old_name_is_told_the_new_one(write: Write) -> None:
    old = write(
        "name = 'n'\n[expert]\nplanner = '2d'\nstarts = 'wide'\n[closed_loop]\nstarts = 9\n[dagger]\nrounds = 1\n"
        "[training]\nloss = 'mse'\n"
    )
    assert set(message(old, {"dataset.target": "displacement", "expert.wide_padding": 1.0}).splitlines()) == {
        f"{old}: expert.planner: is called expert.dimensions now",
        f"{old}: expert.starts: is called dataset.starts now",
        f"{old}: closed_loop: is called kinematic_test now",
        f"{old}: dagger: is called aggregation now",
        f"{old}: training.loss: is no setting any more: the loss is the mean squared error",
        "command line: dataset.target: is called dataset.label_kind now",
        "command line: expert.wide_padding: is called dataset.wide_padding now",
    }
    known = Experiment(name="n").model_dump()
    for before, after in MOVED.items():
        section, _, name = after.partition(".")
        assert not name or name in known[section], after
        assert before.split(".")[-1] not in known.get(before.split(".")[0], {}), before


def test_all_errors_come_at_once_with_file_key_value_and_advice(write: Write) -> None:
    write('name = "base"\n[training]\nlearning_rate = "fast"\n')
    child = write('extends = "a.toml"\nsed = 1\n[policy]\nkind = "plian"\n[evaluation]\nepisodes = 0', "c.toml")
    lines = message(child, {"expert.nodes": -1}).splitlines()
    assert len(lines) == 5
    text = "\n".join(lines)
    assert f"{child.parent / 'a.toml'}: training.learning_rate = 'fast': input should be a valid number" in text
    assert f"{child}: sed: unknown key; did you mean seed?" in text
    assert "policy.kind = 'plian'" in text
    assert "did you mean 'plain'?" in text
    assert f"{child}: evaluation.episodes = 0: input should be greater than or equal to 1" in text
    assert "command line: expert.nodes = -1" in text


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('[scene]\ntargt = [1, 2]\nname = "n"', ["scene.targt: unknown key; did you mean scene.target?"]),
        (TABLE.replace("underside", "undersid"), ["scene.obstacles.0.undersid", "mean scene.obstacles.0.underside?"]),
        (TABLE.replace("[0.5", "[-0.5"), ["scene.obstacles.0.size.0 = -0.5", "greater than 0"]),
        (TABLE.replace('"table"', '"tabel"'), ["scene.obstacles.0", "'tabel'", "'table', 'box'"]),
        (TABLE + "top = 0.1\n", ["scene.obstacles.0: top = 0.1 must be above underside = 0.25"]),
        ("[training]\nlearning_rate = nan", ["training.learning_rate = nan: must be a finite number"]),
        ("[training]\nlearning_rate = 1e400", ["training.learning_rate = inf: must be a finite number"]),
        ("[training]\nepochs = 1.5", ["training.epochs = 1.5: input should be a valid integer"]),
        ("[training]\nepochs = true", ["training.epochs = True: input should be a valid integer"]),
        ("[training]\nepochs = 1979-05-27", ["training.epochs = datetime.date(1979, 5, 27)"]),
        ("training = 3", ["training = 3"]),
        ("[scene]\ntarget = [1.5, 0.0, 0.28, 0.0]\n" + TABLE, ["scene.target = [1.5, 0.0, 0.28, 0.0]", "inside"]),
        ("[scene]\ntarget = [1.5, 0.0]", ["scene.target = [1.5, 0.0]: must have 4 values, not 2"]),
        (
            "[scene]\ntarget = [9.0, 0.0, 0.1, 90.0]",
            ["scene.target.3 = 90.0: is more than a full turn [rad]; 90 degrees are 1.571"],
        ),
        (
            "[scene]\ntarget = [9.0, 0.0, 0.1, 3.3]",
            ["scene.target x = 9 m is outside its bounds [-1.5, 4.5] m", "scene.target z = 0.1 m"],
        ),
        (
            "[scene.start]\nmean = [1.5, 0.0, 0.28, 0.0]\nstd = [0.0, 0.0, 0.0, 0.0]\n" + TABLE,
            ["a.toml: scene.start: 0 of 10240 starts are free (mean [1.5, 0.0, 0.28, 0.0], std", "margin 0.0255 m)"],
        ),
        (
            '[policy]\nkind = "feedback"\n[expert]\ninitial_velocity = "free"\n[scene]\ntarget = [9.0, 0.0, 0.28, 0.0]',
            ['policy.kind = "feedback" learns', "scene.target x = 9 m"],
        ),
        ('name = "../up"', ["name = '../up'", "letters"]),
        ("seed = -1", ["seed = -1"]),
        ('[sweep]\nmethod = "tpe"\n[sweep.space]\nseed = [1]', ["sweep.method = 'tpe'", "'grid' or 'list'"]),
        (
            '[sweep]\nmetric = "training.validation_msee"\n[sweep.space]\nseed = [1]',
            ["sweep.metric = 'training.validation_msee': no summary has", "did you mean 'training.validation_mse'?"],
        ),
        (
            '[sweep]\nshow = ["evaluation.mujoco.success"]\n[sweep.space]\nseed = [1]',
            ["sweep.show", "did you mean 'evaluation.mujoco.success_rate'?"],
        ),
        ("[sweep]\nspace = {}", ["sweep.space"]),
        ("[sweep.space]\nname = ['a']", ["name names the experiment"]),
        ('[sweep]\nmetric = "loss"\n[sweep.space]\nseed = [1]', ["sweep.metric = 'loss'", "training.validation_mse"]),
        (
            '[sweep]\nmetric = "evaluation.mjx.seconds"\n[sweep.space]\nseed = [1]',
            ["no trial has an evaluation by 'mjx'"],
        ),
    ],
)
def test_bad_files(text: str, parts: list[str], write: Write) -> None:
    found = message(write(text if "name =" in text and "[sweep" not in text else 'name = "n"\n' + text))
    for part in parts:
        assert part in found


def test_bad_overrides(write: Write) -> None:
    path = write('name = "n"\n' + TABLE)
    assert "`1` is no index of an array with 1 elements" in message(path, {"scene.obstacles.1.yaw": 0.0})
    assert "`name` is a value and has no keys below it" in message(path, {"name.x.y": 1})
    assert "command line: seed: input should be a valid integer" in message(path, {"seed.x.y": 1})
    assert "did you mean training.epochs?" in message(path, {"training.epoch": 1})
    assert "must be a finite number" in message(path, {"training.learning_rate": math.inf})


def test_files_that_are_no_experiment(write: Write, tmp_path: pathlib.Path) -> None:
    write('name = "n"', "quickstart.toml")
    write("[project]", "quikstar.toml")  # of another program
    assert message(tmp_path / "quikstart.toml").endswith(f"no such file; did you mean {tmp_path / 'quickstart.toml'}?")
    assert message(tmp_path / "smoke.toml").endswith("no such file")
    assert load_experiment(write('\ufeffname = "mark"', "bom.toml")).name == "mark"
    assert "is a folder" in message(tmp_path)
    assert "is empty" in message(write(" \n"))
    assert "is not valid TOML" in message(write("name = \nseed"))
    assert "is not valid TOML" in message(write('name = "a"\nname = "b"'))
    assert "nested too deeply" in message(write("x = " + "[" * 100_000))
    assert "at most 1000000" in message(write("#" * 1_000_001))
    binary = tmp_path / "b.toml"
    binary.write_bytes(bytes(range(256)))
    assert "is not UTF-8 text" in message(binary)


def test_ancestors_that_cannot_be(write: Write) -> None:
    a, b = write('extends = "b.toml"'), write('extends = "a.toml"', "b.toml")
    assert message(a).endswith(f"goes round in a circle: {a} -> {b} -> {a}")
    assert f"c.toml: no such file (which {a} extends)" in message(write('extends = "c.toml"'))
    assert "extends = 3" in message(write("extends = 3"))
    own = write('extends = "own.toml"', "own.toml")
    assert "circle" in message(own)


def test_the_schema_knows_the_keys_of_shipped_files() -> None:
    schema = json_schema()

    def check(table: dict, node: dict) -> None:
        node = schema["$defs"][node["$ref"].split("/")[-1]] if "$ref" in node else node
        for key, value in table.items():
            assert key in node["properties"], key
            if isinstance(value, dict) and "anyOf" not in node["properties"][key]:
                check(value, node["properties"][key])

    for path in SHIPPED:
        check(tomllib.loads(path.read_text()), schema)
    assert schema["$defs"]["TableSettings"]["properties"]["position"]["description"] == "Centre in the plane [m]."
    assert schema["additionalProperties"] is False


def test_no_setting_is_bare() -> None:
    """Every setting says in the schema, and so in --help, what it means."""
    schema = json_schema()
    models = {"Experiment": schema, **schema["$defs"]}
    bare = [
        f"{model}.{key}"
        for model, at in models.items()
        for key, about in at["properties"].items()
        if not about.get("description")
    ]
    assert sum(len(at["properties"]) for at in models.values()) > 130
    assert not bare
