"""The published constants are those of the compiled MuJoCo model, one by one."""

import a1_published as published
import mujoco
import numpy as np
import pytest

from agile_jax.robot import JOINT_NAMES, LEG_NAMES, RobotSettings, build_mujoco_model, load_robot
from agile_jax.scene import SceneSettings, make_scene

LINKS = ["trunk"] + [f"{leg}_{link}" for leg in LEG_NAMES for link in ("hip", "thigh", "calf")]
JOINTS = [f"{leg}_{joint}" for leg in LEG_NAMES for joint in JOINT_NAMES]


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), 0.002)


@pytest.fixture(scope="module")
def robot():
    return load_robot(RobotSettings())


def test_constants_read_from_the_mjcf_are_the_published_ones(robot):
    links = published.links()
    read = {name: value for name, value in robot._asdict().items() if name != "shape"}  # test_a1_shapes.py
    inertias = [[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] for xx, yy, zz, xy, xz, yz in (k.inertia for k in links)]
    expected = {
        "link_masses": [k.mass for k in links],
        "link_coms": [k.com for k in links],
        "link_inertias": inertias,
        **{name: getattr(published, name.upper()) for name in read if not name.startswith("link_")},
    }
    assert expected.keys() == read.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(read[name], value, rtol=0, atol=1e-6, err_msg=name)


def test_total_mass(model, robot):
    assert model.body_mass.sum() == pytest.approx(12.453, abs=1e-12)
    assert robot.link_masses.sum() == pytest.approx(12.453, abs=1e-12)


def test_links(model, robot):
    assert [model.body(index).name for index in range(1, model.nbody)] == LINKS
    np.testing.assert_allclose(model.body_mass[1:], robot.link_masses)
    np.testing.assert_allclose(model.body_ipos[1:], robot.link_coms)
    for index in range(13):
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[index + 1])
        axes = axes.reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[index + 1]) @ axes.T
        np.testing.assert_allclose(inertia, robot.link_inertias[index], atol=1e-12, err_msg=LINKS[index])


def test_principal_inertias_are_the_published_ones(robot):
    """The menagerie's diaginertia, as published; our tensors come from the description it derives from."""
    principal = np.sort(np.linalg.eigvalsh(robot.link_inertias), -1)
    np.testing.assert_allclose(principal[1::3], np.tile([0.000468983, 0.00055293, 0.000807752], (4, 1)), rtol=1e-5)
    np.testing.assert_allclose(principal[2::3], np.tile([0.00133944, 0.00513936, 0.00555739], (4, 1)), rtol=1e-5)
    np.testing.assert_allclose(principal[3::3], np.tile([3.54834e-05, 0.00339393, 0.00340344], (4, 1)), rtol=1e-5)


def test_calf_is_its_link_and_the_foot():
    link_mass, foot_mass = 0.166, 0.060
    link_com, foot_pos = np.array([0.006435, 0.0, -0.107388]), np.array([0.0, 0.0, -0.2])
    link_inertia = np.array(
        [[0.002997972, 0.0, -0.000141163], [0.0, 0.003014022, 0.0], [-0.000141163, 0.0, 3.2426e-05]]
    )
    mass = link_mass + foot_mass
    com = (link_mass * link_com + foot_mass * foot_pos) / mass

    def at_com(point_mass, offset):
        return point_mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))

    inertia = link_inertia + at_com(link_mass, link_com - com)
    inertia += 0.4 * foot_mass * 0.02**2 * np.eye(3) + at_com(foot_mass, foot_pos - com)
    xx, yy, zz, xy, xz, yz = published.CALF.inertia
    assert mass == pytest.approx(published.CALF.mass)
    np.testing.assert_allclose(published.CALF.com, com, atol=1e-9)
    np.testing.assert_allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], inertia, atol=1e-12)


def test_geometry(model, robot):
    for leg, name in enumerate(LEG_NAMES):
        np.testing.assert_allclose(model.body(f"{name}_hip").pos, robot.hip_pos_base[leg])
        np.testing.assert_allclose(model.body(f"{name}_thigh").pos, [0.0, robot.abad_offset[leg], 0.0])
        np.testing.assert_allclose(model.body(f"{name}_calf").pos, [0.0, 0.0, -robot.thigh_length])
        foot = model.geom(f"{name}_foot")
        np.testing.assert_allclose(foot.pos, [0.0, 0.0, -robot.calf_length])
        assert foot.size[0] == robot.foot_radius
        assert foot.friction[0] == robot.foot_friction


def test_joints(model, robot):
    assert [model.joint(index).name for index in range(1, model.njnt)] == JOINTS
    assert [model.actuator(index).name for index in range(model.nu)] == JOINTS
    np.testing.assert_allclose(model.jnt_range[1:, 0], robot.joint_lower)
    np.testing.assert_allclose(model.jnt_range[1:, 1], robot.joint_upper)
    assert model.jnt_limited[1:].all()
    np.testing.assert_allclose(np.tile([[1, 0, 0], [0, 1, 0], [0, 1, 0]], (4, 1)), model.jnt_axis[1:])
    np.testing.assert_allclose(model.dof_damping[6:], robot.joint_damping)
    np.testing.assert_allclose(model.dof_armature[6:], robot.joint_armature)
    np.testing.assert_allclose(model.dof_frictionloss[6:], robot.joint_friction)
    assert not model.dof_damping[:6].any()
    assert not model.dof_armature[:6].any()


def test_actuators_are_direct_torques(model, robot):
    np.testing.assert_allclose(model.actuator_ctrlrange, np.stack([-robot.torque_limit, robot.torque_limit], -1))
    assert model.actuator_ctrllimited.all()
    np.testing.assert_allclose(model.actuator_gear[:, 0], 1.0)
    data = mujoco.MjData(model)
    data.ctrl[:] = np.linspace(-40.0, 40.0, 12)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator[6:], np.clip(data.ctrl, -33.5, 33.5))


def test_home(model, robot):
    home = model.key("home").qpos
    np.testing.assert_allclose(home[7:], robot.home_joint_pos)
    assert home[2] == robot.nominal_height


def test_joint_limits_are_the_published_degrees(robot):
    np.testing.assert_allclose(np.rad2deg(robot.joint_lower[:3]), [-46.0, -60.0, -154.5], atol=1e-3)
    np.testing.assert_allclose(np.rad2deg(robot.joint_upper[:3]), [46.0, 240.0, -52.5], atol=1e-3)
