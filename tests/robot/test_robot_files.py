"""A robot's files: what they say is told by content, and they can be taken along."""

import pathlib
import shutil

import pytest
from quadruped import tiny

from agile_jax.experiment import load_experiment
from agile_jax.robot import RobotSettings, copy_robot, load_robot, robot_digest
from agile_jax.run_directory import write_identity

MESH = "v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nv 0 0 {size}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def write_robot(folder: pathlib.Path, trunk_mass: float = 5.0, mesh_size: float = 0.1) -> RobotSettings:
    """A main file that only includes another one, which needs a mesh of a third folder."""
    (folder / "robots/parts").mkdir(parents=True, exist_ok=True)
    (folder / "meshes").mkdir(exist_ok=True)
    (folder / "meshes/nose.obj").write_text(MESH.format(size=mesh_size))
    part = tiny(
        ('mass="5"', f'mass="{trunk_mass}"'),
        ("<worldbody>", '<asset><mesh name="nose" file="nose.obj"/></asset><worldbody>'),
        ("<freejoint/>", '<freejoint/><geom type="mesh" mesh="nose" mass="0.1"/>'),
        ('angle="radian"', 'angle="radian" meshdir="../meshes"'),
    )
    (folder / "robots/parts/body.xml").write_text(part)
    main = folder / "robots/main.xml"
    main.write_text('<mujoco><include file="parts/body.xml"/></mujoco>')
    return RobotSettings(name=str(main))


def test_the_digest_follows_what_the_files_say_and_not_where_they_are(tmp_path):
    first = robot_digest(write_robot(tmp_path / "a"))
    assert first is not None
    assert robot_digest(write_robot(tmp_path / "b")) == first
    comment = write_robot(tmp_path / "c")
    included = tmp_path / "c/robots/parts/body.xml"
    included.write_text(included.read_text().replace("<worldbody>", "<!-- the same robot --><worldbody>"))
    assert robot_digest(comment) == first
    assert robot_digest(write_robot(tmp_path / "b", trunk_mass=40.0)) != first
    assert robot_digest(write_robot(tmp_path / "d", mesh_size=0.11)) != first
    assert robot_digest(RobotSettings()) is None


def test_a_copy_has_all_files_and_is_the_same_robot(tmp_path):
    settings = write_robot(tmp_path / "a", trunk_mass=6.9)
    digest = robot_digest(settings)
    run = tmp_path / "run"
    run.mkdir()
    copied = copy_robot(settings, run / "robot")
    (tmp_path / "a").rename(tmp_path / "gone")
    assert load_robot(copied).link_masses[0] == pytest.approx(7.0)
    assert robot_digest(copied) == digest
    assert copy_robot(copied, run / "robot") == copied  # going on from the run
    run.rename(tmp_path / "elsewhere")
    moved = RobotSettings(name=copied.name.replace(str(run), str(tmp_path / "elsewhere")))
    assert robot_digest(moved) == digest
    other = copy_robot(write_robot(tmp_path / "b", trunk_mass=40.0), tmp_path / "elsewhere/robot")
    assert load_robot(other).link_masses[0] == pytest.approx(40.1)
    assert copy_robot(RobotSettings(), run / "robot") == RobotSettings()


def test_a_robot_s_path_is_relative_to_the_file_that_sets_it_and_a_run_takes_the_robot_along(tmp_path, monkeypatch):
    write_robot(tmp_path / "base", trunk_mass=6.9, mesh_size=0.05)
    (tmp_path / "base/base.toml").write_text('name = "base"\n[robot]\nname = "robots/main.xml"\n')
    (tmp_path / "child").mkdir()
    child = tmp_path / "child/child.toml"
    child.write_text('name = "child"\nextends = "../base/base.toml"\n[sweep.space]\n"robot.name" = ["x.xml", "a1"]\n')
    experiment = load_experiment(child)
    assert experiment.robot.name == str(tmp_path / "base/robots/main.xml")
    assert experiment.sweep is not None
    assert experiment.sweep.space["robot.name"] == (str(tmp_path / "child/x.xml"), "a1")
    monkeypatch.chdir(tmp_path / "base")
    assert load_experiment(child, {"robot.name": "robots/main.xml"}).robot == experiment.robot
    run = tmp_path / "runs/child"
    write_identity(run, experiment)
    digest = robot_digest(experiment.robot)
    shutil.rmtree(tmp_path / "base/robots")
    run.rename(tmp_path / "given")
    opened = load_experiment(tmp_path / "given/experiment.toml")
    assert opened.robot.name == str(tmp_path / "given/robot/robots/main.xml")
    assert robot_digest(opened.robot) == digest
    write_identity(tmp_path / "given", opened)
    assert load_experiment(tmp_path / "given/experiment.toml") == opened
