"""Clearance of the robot's collision geometry, against MuJoCo's own distances."""

import jax
import mujoco
import numpy as np
import pytest

from agile_jax.robot import (
    RobotSettings,
    body_clearance,
    build_mujoco_model,
    collision_shapes,
    load_robot,
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
