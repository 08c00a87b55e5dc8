"""Clearance of the robot's collision geometry, against MuJoCo's own distances."""

import jax
import mujoco
import numpy as np
import pytest
from test_mjcf import settings_of

from agile_jax.robot import (
    RobotSettings,
    body_clearance,
    build_mujoco_model,
    collision_shapes,
    load_robot,
    own_clearance,
    standing_qpos,
)
from agile_jax.scene import BoxSettings, SceneSettings, TableSettings, make_scene

SCENE = make_scene(
    SceneSettings(
        obstacles=(
            TableSettings(kind="table", position=(1.5, 0.2), size=(0.5, 1.0), underside=0.25, yaw=0.3),
            BoxSettings(kind="box", position=(0.0, 1.2, 0.1), size=(0.2, 0.3, 0.2), yaw=-0.5),
        )
    )
)
MODEL = build_mujoco_model(SCENE, RobotSettings(), 0.002)
ROBOT = load_robot(RobotSettings())


def nearest_in_mujoco(qpos: np.ndarray) -> float:
    data = mujoco.MjData(MODEL)
    data.qpos[:] = qpos
    mujoco.mj_forward(MODEL, data)
    obstacles = [i for i in range(MODEL.ngeom) if MODEL.geom(i).name.startswith("obstacle_")]
    parts = [i for i in range(MODEL.ngeom) if MODEL.geom(i).bodyid[0] > 0 and MODEL.geom(i).conaffinity[0] & 2]
    return min(mujoco.mj_geomDistance(MODEL, data, i, j, 10.0, None) for i in parts for j in obstacles)


@pytest.fixture(scope="module")
def postures() -> np.ndarray:
    """Random poses, tilts and joint angles near the obstacles."""
    generator = np.random.default_rng(0)
    result = []
    for k in range(60):
        center = SCENE.obstacle_centers[k % 2, :2]
        place = [*(center + generator.uniform(-0.8, 0.8, 2)), generator.uniform(0.15, 0.35), generator.uniform(-3, 3)]
        qpos = np.array(standing_qpos(ROBOT, np.array(place)), float)
        qpos[3:7] += generator.normal(0, 0.15, 4)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        qpos[7:] += generator.uniform(-0.4, 0.4, 12)
        result.append(qpos)
    return np.array(result)


def test_clearance_is_mujocos_distance(postures: np.ndarray):
    shapes = collision_shapes(MODEL)
    found = jax.vmap(lambda qpos: body_clearance(ROBOT, shapes, SCENE, qpos))(postures.astype(np.float32))
    expected = np.array([nearest_in_mujoco(qpos) for qpos in postures])
    apart = expected > 1e-4
    assert 15 < apart.sum() < 60
    np.testing.assert_allclose(np.asarray(found)[apart], expected[apart], atol=2e-5)
    assert (np.asarray(found)[~apart] < 2e-4).all()


def test_an_empty_scene_is_infinitely_far():
    empty = make_scene(SceneSettings())
    shapes = collision_shapes(build_mujoco_model(empty, RobotSettings(), 0.002))
    assert body_clearance(ROBOT, shapes, empty, np.zeros(19)) == np.inf


def least_to_itself(qpos: np.ndarray) -> float:
    """By MuJoCo, for every pair that counts."""
    data = mujoco.MjData(MODEL)
    data.qpos[:] = qpos
    mujoco.mj_forward(MODEL, data)
    geoms = [i for i in range(MODEL.ngeom) if MODEL.geom_conaffinity[i] & 4]
    legs = {i: MODEL.body(MODEL.geom_bodyid[i]).name[:2] for i in geoms}
    assert len(geoms) == 2 + 4 * 4
    return min(mujoco.mj_geomDistance(MODEL, data, i, j, 1.0, None) for i in geoms for j in geoms if legs[i] < legs[j])


def test_own_clearance_is_mujocos_distance():
    """At any joint angles, also where legs overlap."""
    own, angles = collision_shapes(MODEL).own, np.random.default_rng(1).uniform(size=(60, 12))
    qpos = np.tile([3.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], (60, 1))
    qpos = np.hstack([qpos, ROBOT.joint_lower + angles * (ROBOT.joint_upper - ROBOT.joint_lower)])
    found = np.asarray(jax.vmap(lambda one: own_clearance(ROBOT, own, one))(qpos.astype(np.float32)))
    expected = np.array([least_to_itself(one) for one in qpos])
    assert (expected > 1e-3).sum() > 10
    assert (expected < -1e-3).sum() > 5
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_standing_legs_keep_off_the_trunk_by_the_gap_at_the_hips():
    """The inside of a thigh at 0.047 + 0.08505 - 0.0225 m, the trunk's side at 0.098 m; the posture does not matter."""
    own = collision_shapes(MODEL).own
    for height in (0.14, 0.2, 0.28):
        standing = standing_qpos(ROBOT, np.array([3.0, 1.0, height, 0.7]))
        assert float(own_clearance(ROBOT, own, standing)) == pytest.approx(0.01155, abs=1e-5)


def test_a_leg_in_the_other_and_a_leg_in_the_trunk_overlap():
    own, standing = collision_shapes(MODEL).own, np.array(standing_qpos(ROBOT, np.array([0.0, 0.0, 0.2, 0.0])))
    across = standing.copy()
    across[[7, 10]] = 0.8, -0.8  # both front feet to the middle
    assert float(own_clearance(ROBOT, own, across)) < -0.01


@pytest.mark.parametrize(("name", "boxes"), [("go2", 3), ("mini_cheetah", 0)])
def test_other_robots_stand_clear_of_themselves(name: str, boxes: int):
    """What counts are the boxes, cylinders and meshes of its file; Mini Cheetah's has no trunk that collides."""
    settings = settings_of(name)
    robot, model = load_robot(settings), build_mujoco_model(make_scene(SceneSettings()), settings, 0.002)
    own = collision_shapes(model).own
    assert len(own.box_halves) == boxes
    home = np.concatenate([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], robot.home_joint_pos])
    crossed = home + np.concatenate([np.zeros(7), np.tile([0.8, 0.0, 0.0, -0.8, 0.0, 0.0], 2)])
    own_of = jax.jit(lambda one: own_clearance(robot, own, one))
    assert float(own_of(home)) > 0.02
    assert float(own_of(crossed)) < 0.01
