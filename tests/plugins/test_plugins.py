"""The registry of plugins: what is refused, and with which words."""

import os
import pathlib
import subprocess
import sys

import pytest

import agile_jax as aj
from agile_jax import plugins
from agile_jax.experiment import Experiment
from agile_jax.plugins import Shipped

ROOT = pathlib.Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("policy.kind", "residul", "'plain', 'residual', 'feedback'; did you mean 'residual'?"),
        ("expert.kind", "mine", "must be one of 'minimum_time'"),
        ("control.kind", "mine", "must be one of 'mpc'"),
    ],
)
def test_an_unknown_kind_lists_the_known_ones_and_says_how_to_add_one(key: str, value: str, words: str) -> None:
    with pytest.raises(aj.BadInput) as error:
        aj.load_experiment(ROOT / "experiments" / "smoke.toml", {key: value})
    assert f"{key} = '{value}'" in str(error.value)
    assert words in str(error.value)
    assert "--plugin MODULE" in str(error.value)


def test_an_unknown_obstacle_too(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "sofa.toml"
    file.write_text('name = "sofa"\n[[scene.obstacles]]\nkind = "sofa"\nposition = [1.0, 0.0]\n')
    with pytest.raises(aj.BadInput, match=r"'sofa'.*'table', 'box'.*--plugin MODULE"):
        aj.load_experiment(file)


def test_a_file_alone_imports_nothing(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "evil.py").write_text("raise SystemExit('imported')")
    (tmp_path / "evil.toml").write_text('name = "evil"\n[policy]\nkind = "evil"\n')
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(aj.BadInput, match="must be one of"):
        aj.load_experiment(tmp_path / "evil.toml")
    assert "evil" not in sys.modules


def test_modules_that_cannot_be_loaded_are_named(tmp_path: pathlib.Path) -> None:
    with pytest.raises(aj.BadInput, match="plugin no_such_module cannot be imported"):
        plugins.load(["no_such_module"])
    with pytest.raises(aj.BadInput, match="no such file"):
        plugins.load([str(tmp_path / "missing.py")])
    (tmp_path / "json.py").write_text("")
    with pytest.raises(aj.BadInput, match="json is another module already"):
        plugins.load([str(tmp_path / "json.py")])
    (tmp_path / "broken_plugin.py").write_text("1 / 0")
    with pytest.raises(aj.BadInput, match="ZeroDivisionError"):
        plugins.load([str(tmp_path / "broken_plugin.py")])


def test_a_worker_with_another_version_is_refused(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "versioned_plugin.py"
    file.write_text("__version__ = '1.5'\n")
    with pytest.raises(aj.BadInput, match=r"is versioned_plugin==1\.5\+\w+ on a worker, versioned_plugin==1\.4 here"):
        plugins.unpack(Shipped(((str(file), "versioned_plugin==1.4"),), b""))


def test_a_plugin_of_the_main_script_works_without_workers_only(tmp_path: pathlib.Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import agile_jax as aj\n"
        "from agile_jax.plugins import register\n"
        "@register('expert', 'none')\n"
        "def make(scene, settings):\n"
        "    return lambda scene, start, initial_velocity: None\n"
        "e = aj.Experiment.model_validate({'name': 'none', 'expert': {'kind': 'none'}})\n"
        "print(aj.solve(e, (0, 0, 0.28, 0)).cause)\n"
        "from agile_jax import plugins\n"
        "try:\n"
        "    plugins.ship(print, 1)\n"
        "except aj.BadInput as error:\n"
        "    print(error)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, check=True)
    first, second = ended.stdout.splitlines()
    assert first == "the expert 'none' found no path"
    assert "not seen by worker processes: move it to a module of its own" in second


def test_an_installed_package_needs_no_option(tmp_path: pathlib.Path) -> None:
    """With an entry point, as pip leaves it; and its module is loaded only when a kind is not the package's own."""
    (tmp_path / "my_obstacles.py").write_text(
        "from typing import Literal\n"
        "from agile_jax.plugins import register\n"
        "from agile_jax.scene import Box, ObstacleSettings\n"
        "@register('obstacle', 'post')\n"
        "class Post(ObstacleSettings):\n"
        "    kind: Literal['post']\n"
        "    def boxes(self):\n"
        "        return [Box((1.0, 0.0, 0.5), (0.1, 0.1, 0.5))]\n"
    )
    info = tmp_path / "my_obstacles-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-obstacles\nVersion: 1.2\n")
    (info / "top_level.txt").write_text("my_obstacles\n")
    (info / "entry_points.txt").write_text("[agile_jax.plugins]\nobstacles = my_obstacles\n")
    program = (
        "import sys, agile_jax as aj\n"
        "from agile_jax import plugins\n"
        "aj.Experiment(name='a')\n"
        "assert 'my_obstacles' not in sys.modules\n"
        "e = aj.Experiment.model_validate({'name': 'a', 'scene': {'obstacles': [{'kind': 'post'}]}})\n"
        "print(e.scene.obstacles, plugins.digests(e.model_dump(mode='json')))\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)])}
    ended = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert "Post(kind='post', yaw=0.0)" in ended.stdout
    assert "{'obstacle': 'my_obstacles==1.2+" in ended.stdout


def test_a_name_belongs_to_one_module() -> None:
    def make() -> None: ...

    plugins.register("policy", "taken")(make)
    make.__module__ = "elsewhere"
    with pytest.raises(aj.BadInput, match="registered by test_plugins already"):
        plugins.register("policy", "taken")(make)


def test_a_policy_must_be_one() -> None:
    plugins.register("policy", "number")(lambda scene, limits, settings: 3)
    settings = Experiment.model_validate({"name": "n", "policy": {"kind": "number"}})
    with pytest.raises(aj.BadInput, match="'number' is int, not a Policy"):
        aj.policy.make_policy(aj.scene.make_scene(settings.scene), settings.expert.limits, settings.policy)
