"""PyBullet against MuJoCo where they must agree, against mechanics where they need not, and the rules of the batch."""

import copy
import subprocess
import sys
import xml.etree.ElementTree as Xml
from itertools import product

import mujoco
import numpy as np
import pytest

from agile_jax.robot import GRAVITY, RobotSettings, build_mujoco_model, standing_qpos
from agile_jax.robot.mjcf import robot_spec
from agile_jax.scene import SceneSettings, TableSettings, make_scene
from agile_jax.settings import BadInput
from agile_jax.simulation import BulletPhysics, MujocoPhysics, check_bullet
from agile_jax.simulation.physics.urdf import GEAR, write_urdf

pybullet = pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'agile_jax[pybullet]'")

DT = 0.001
TABLE = TableSettings(kind="table", position=(1.0, 0.0), size=(0.5, 1.0), underside=0.25)


def model_with(**joints: float) -> mujoco.MjModel:
    """The A1 and a table, with 1 kHz; damping, friction and armature of the joints are 0 unless given."""
    model = build_mujoco_model(make_scene(SceneSettings(obstacles=(TABLE,))), RobotSettings(), DT)
    for name in ("damping", "frictionloss", "armature"):
        getattr(model, f"dof_{name}")[6:] = joints.get(name, 0.0)
    return model


@pytest.fixture(scope="module")
def flying(robot) -> np.ndarray:
    """A crouching robot in the air, turned about all axes, its joints far from their limits."""
    qpos = np.array(standing_qpos(robot, np.array([0.3, -0.2, 0.25, 0.0])), float)
    qpos[2], qpos[3:7] = 1.5, np.array([0.8, 0.3, -0.4, 0.33])
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    return qpos


@pytest.fixture(scope="module")
def torques() -> np.ndarray:
    return np.random.default_rng(0).uniform(-5.0, 5.0, 12)


def fly(physics, qpos, torques, steps=20):
    """Coordinates and velocities of one robot after constant torques [Nm]."""
    with physics:
        physics.reset(qpos[None])
        for _ in range(steps):
            sensed = physics.step(torques[None])
    return sensed.qpos[0], sensed.qvel[0]


def test_rigid_bodies_fly_alike(flying, torques):
    model = model_with()
    expected = fly(MujocoPhysics(model, 1, 1), flying, torques)
    assert np.abs(expected[1][6:]).max() > 10.0
    actual = fly(BulletPhysics(model, 1), flying, torques)
    np.testing.assert_allclose(actual[0][7:], expected[0][7:], atol=1e-8)
    np.testing.assert_allclose(actual[1][6:], expected[1][6:], atol=1e-8)
    np.testing.assert_allclose(actual[1][3:6], expected[1][3:6], atol=1e-6)
    # The trunk's origin is moved by MuJoCo, its centre of mass by Bullet: they differ by the square of a step.
    np.testing.assert_allclose(actual[0][:7], expected[0][:7], atol=1e-5)
    np.testing.assert_allclose(actual[1][:3], expected[1][:3], atol=1e-3)


def test_substeps_are_steps_of_the_physics(flying, torques):
    for physics in (MujocoPhysics, BulletPhysics):
        more = {"threads": 1} if physics is MujocoPhysics else {}
        one = fly(physics(model_with(armature=0.01), 1, **more), flying, torques, 6)
        three = fly(physics(model_with(armature=0.01), 1, **more, substeps=3), flying, torques, 2)
        for alone, together in zip(one, three, strict=True):
            np.testing.assert_array_equal(alone, together)


def test_damping_is_a_torque_against_the_speed(flying, torques):
    damping = np.tile([1.0, 2.0, 2.0], 4)
    model = model_with()
    model.dof_damping[6:] = damping
    with MujocoPhysics(model_with(), 1, 1) as physics:  # its own damping is implicit
        sensed = physics.reset(flying[None])
        for _ in range(20):
            sensed = physics.step(torques - damping * sensed.qvel[:, 6:])
    actual = fly(BulletPhysics(model, 1), flying, torques)
    np.testing.assert_allclose(actual[0][7:], sensed.qpos[0, 7:], atol=1e-8)


def test_dry_friction_holds_up_to_its_torque(flying):
    torques = np.zeros(12)
    torques[[2, 5]] = 0.15, 0.6
    weightless = model_with(frictionloss=0.2)
    weightless.opt.gravity[:] = 0.0
    speed = np.abs(fly(BulletPhysics(weightless, 1), flying, torques)[1][6:])
    assert speed[2] < 1e-6
    assert speed[5] > 0.3
    free = copy.copy(weightless)
    free.dof_frictionloss[:] = 0.0
    assert np.abs(fly(BulletPhysics(free, 1), flying, torques)[1][8]) > 0.1


def test_a_rotor_is_geared_to_its_joint_and_reacts_on_its_parent(flying, torques):
    """Its energy is I/2 (|w|^2 + 2 g q' a.w + g^2 q'^2), w of its parent, in whose inertia the first term is."""
    armature = 0.01
    model = model_with()
    data = mujoco.MjData(model)
    data.qpos[:] = flying
    mujoco.mj_forward(model, data)
    mass, rotating = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_fullM(model, data, mass)
    for joint in range(1, model.njnt):
        dof, parent = model.jnt_dofadr[joint], model.body_parentid[model.jnt_bodyid[joint]]
        mujoco.mj_jacBody(model, data, None, rotating, parent)
        coupling = armature / GEAR * data.xaxis[joint] @ rotating
        mass[dof] += coupling
        mass[:, dof] += coupling
        mass[dof, dof] += armature
    force = np.concatenate([np.zeros(6), torques]) - data.qfrc_bias
    acceleration = np.linalg.solve(mass, force)
    model.dof_armature[6:] = armature
    _, qvel = fly(BulletPhysics(model, 1), flying, torques, 1)
    np.testing.assert_allclose(qvel[6:] / DT, acceleration[6:], rtol=1e-6)
    # Against MuJoCo, which leaves the coupling out: a tenth of the speeds after 20 ms; a hundredth without it.
    theirs = fly(MujocoPhysics(model, 1, 1), flying, torques)[1][6:]
    real, without = (
        np.abs(fly(BulletPhysics(model, 1, rotor_reaction=reaction), flying, torques)[1][6:] - theirs).max()
        for reaction in (True, False)
    )
    assert 0.02 < real / np.abs(theirs).max() < 0.1
    assert without / np.abs(theirs).max() < 0.01


@pytest.fixture(scope="module")
def standing(starts, robot):
    """The six starts, whose joints are held for 0.6 s at 500 Hz: flags (300, 6, 2) on the way, and what is sensed."""
    model = build_mujoco_model(make_scene(SceneSettings(obstacles=(TABLE,))), RobotSettings(), DT)
    return model, *hold(model, starts, np.arange(6))


def hold(model, starts, order, slots=None, steps=300):
    """Hold the joints of starts in an order; `slots`: so many episodes at once, in place of those before."""
    flags, ends, count = [], [], slots or len(order)
    with BulletPhysics(model, count, substeps=2) as physics:
        for part in np.array_split(order, len(order) // count):
            sensed = physics.reset(starts[part])
            flags.append([])
            for _ in range(steps):
                joints = 60.0 * (starts[part, 7:] - sensed.qpos[:, 7:]) - 1.0 * sensed.qvel[:, 6:]
                sensed = physics.step(joints)
                flags[-1].append(np.stack([sensed.obstacle_contact, sensed.floor_contact], -1))
            ends.append(np.concatenate([sensed.qpos, sensed.qvel, sensed.foot_contact], -1))
    return np.concatenate(flags, 1), np.concatenate(ends)


def test_a_robot_that_stands_stays_and_feels_its_feet(standing, starts):
    _, _, ends = standing
    up = [0, 1, 2, 3]
    assert np.abs(ends[up, :2] - starts[up, :2]).max() < 0.03
    assert np.abs(ends[up, 2] - starts[up, 2]).max() < 0.03  # the springs give way
    assert np.abs(ends[up, 19:37]).max() < 0.05
    assert ends[up, 37:].all()


def test_forbidden_contacts_are_flagged(standing):
    _, flags, ends = standing
    obstacle, floor = flags.any(0).T
    np.testing.assert_array_equal(obstacle, [False, False, False, False, True, False])  # its back is in the table
    np.testing.assert_array_equal(floor, [False, False, False, False, False, True])  # it fell on its side
    assert not ends[5, 37:].any()


def test_episodes_depend_neither_on_neighbours_nor_on_what_was_before(standing, starts):
    model, flags, ends = standing
    again, order = hold(model, starts, [5, 0, 4, 3], slots=1), [5, 0, 4, 3]
    np.testing.assert_array_equal(again[0], flags[:, order])
    np.testing.assert_array_equal(again[1], ends[order])


def test_paused_and_broken_episodes(standing, starts):
    model = standing[0]
    with BulletPhysics(model, 3, substeps=2) as physics:
        began = physics.reset(starts[:3])
        np.testing.assert_array_equal(began.qpos, starts[:3])
        torques = np.zeros((3, 12))
        torques[1, 4] = np.nan
        sensed = physics.step(torques, np.array([False, True, True]))
        np.testing.assert_array_equal(sensed.qpos[0], starts[0])
        assert np.isnan(sensed.qpos[1]).all()
        assert not sensed.foot_contact[1].any()
        assert np.isfinite(sensed.qpos[2]).all()
        sensed = physics.step(np.zeros((3, 12)))
        assert np.isnan(sensed.qvel[1]).all()
        sensed = physics.reset(starts[1:2], np.array([1]))
        np.testing.assert_array_equal(sensed.qpos[1], starts[1])
        assert not np.array_equal(sensed.qpos[2], starts[2])


def test_a_push_is_its_momentum(flying):
    model, force, steps = model_with(), np.array([30.0, -20.0, 10.0]), 10
    with BulletPhysics(model, 1, substeps=2) as physics:
        physics.reset(flying[None])
        for _ in range(steps):
            sensed = physics.step(np.zeros((1, 12)), pushes=force[None])
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = sensed.qpos[0], sensed.qvel[0]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    mass, seconds = model.body_mass.sum(), 2 * steps * DT
    expected = (force / mass - [0.0, 0.0, GRAVITY]) * seconds
    np.testing.assert_allclose(data.subtree_linvel[1], expected, atol=1e-4)


def test_a_client_ends_with_what_holds_it():
    """PyBullet has 1,024 at most."""
    physics = BulletPhysics(model_with(), 1)
    client = physics._worlds[0]._bullet._number
    assert pybullet.isConnected(client)
    del physics
    assert not pybullet.isConnected(client)
    physics = BulletPhysics(model_with(), 1)
    physics.close()
    physics.close()


def test_torques_are_cut_to_the_limit(flying):
    model = model_with()
    limit = model.actuator_ctrlrange[:, 1]
    np.testing.assert_array_equal(
        fly(BulletPhysics(model, 1), flying, 3 * limit, 3)[1], fly(BulletPhysics(model, 1), flying, limit, 3)[1]
    )


def test_the_urdf_has_the_masses_of_the_model_and_a_rotor_a_joint(tmp_path):
    model = model_with(armature=0.01)
    links = Xml.parse(write_urdf(model, tmp_path)).findall("link")
    masses = {link.get("name"): float(link.find("inertial/mass").get("value")) for link in links}
    assert sum(masses.values()) == pytest.approx(model.body_mass.sum(), rel=1e-12)
    assert sum(name.endswith("_rotor") for name in masses) == 12
    assert len(links) == 13 + 4 + 12


def test_a_link_lighter_than_its_rotors_keeps_its_inertia(tmp_path):
    def inertia(armature: float) -> np.ndarray:
        links = Xml.parse(write_urdf(model_with(armature=armature), tmp_path)).findall("link")
        (hip,) = (link for link in links if link.get("name") == "FR_hip")
        return np.array([float(hip.find("inertial/inertia").get(key)) for key in ("ixx", "iyy", "izz")])

    np.testing.assert_allclose(inertia(0.0) - inertia(0.01), 0.01 / GEAR**2, rtol=1e-9)
    np.testing.assert_array_equal(inertia(0.5), inertia(0.0))


def test_a_mesh_collides_as_its_hull():
    """A robot dropped on its back lies on a box of 8 corners as high as on its trunk, and ends there."""
    spec = robot_spec(RobotSettings())
    spec.add_mesh(name="hull", uservert=np.array(list(product((-0.2, 0.2), (-0.1, 0.1), (-0.05, 0.08)))).ravel())
    spec.geom("trunk_body").type, spec.geom("trunk_body").meshname = mujoco.mjtGeom.mjGEOM_MESH, "hull"
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=1, conaffinity=0)
    spec.option.timestep = DT
    model = spec.compile()
    qpos = model.key_qpos[0].copy()
    qpos[2:7] = [0.09, 0.0, 1.0, 0.0, 0.0]
    with BulletPhysics(model, 1) as physics:
        physics.reset(qpos[None])
        for _ in range(150):
            sensed = physics.step(np.zeros((1, 12)))
    assert sensed.floor_contact[0]
    assert sensed.qpos[0, 2] == pytest.approx(0.08, abs=2e-3)


def test_what_cannot_be_written_is_refused(tmp_path):
    model = model_with()
    model.geom_type[model.geom("trunk_body").id] = mujoco.mjtGeom.mjGEOM_ELLIPSOID
    with pytest.raises(BadInput, match="trunk_body: its shape ellipsoid has no counterpart in a URDF"):
        write_urdf(model, tmp_path)


def test_a_missing_pybullet_is_refused(monkeypatch):
    monkeypatch.setattr("agile_jax.simulation.physics.bullet_world.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r'needs PyBullet: pip install "agile_jax\[pybullet\]"'):
        check_bullet(model_with())


def test_pybullet_prints_nothing():
    script = (
        "from agile_jax.simulation.physics.bullet_world import World\n"
        "World().close()\nimport sys\nprint('out')\nprint('error', file=sys.stderr)"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout == "out\n"
    assert result.stderr == "error\n"
