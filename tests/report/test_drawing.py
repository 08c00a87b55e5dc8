"""The renderer without OpenGL against geometry by hand, against the robot's own and against MuJoCo's renderer."""

import time

import mujoco
import numpy as np
import pytest

from agile_jax.report.video.camera import ELEVATION, VIEW_HEIGHT, Shot, axes_of_view
from agile_jax.report.video.drawing import Projection, draw_frame
from agile_jax.report.video.opengl import RenderError, opengl_frames
from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot
from agile_jax.scene import Scene

WIDTH, HEIGHT = 640, 360
SCALE = HEIGHT / VIEW_HEIGHT  # [pixel/m]
LOOK_AT = np.array([0.0, 0.0, 0.3])

PURE = '<geom type="{kind}" size="{size}" rgba="1 0 0 1"/>'
BODY = """
<mujoco><worldbody><body pos="{pos}" euler="{euler}"><freejoint/>{geom}</body></worldbody></mujoco>
"""


def colored_box(image: np.ndarray, channel: int) -> np.ndarray:
    """Columns and rows [left, top, right, bottom] of the pixels in which one channel stands out."""
    others = np.delete(image.astype(int), channel, axis=2).max(2)
    rows, columns = np.nonzero(image[..., channel].astype(int) - others > 60)
    assert len(rows), "nothing was drawn"
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])


def drawn(kind: str, size: str, pos: str = "0 0 0.3", euler: str = "0 0 0") -> np.ndarray:
    model = mujoco.MjModel.from_xml_string(BODY.format(pos=pos, euler=euler, geom=PURE.format(kind=kind, size=size)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return draw_frame(model, data, LOOK_AT, WIDTH, HEIGHT)


def around_middle(half_width: float, half_height: float, right: float = 0.0, up: float = 0.0) -> np.ndarray:
    """The pixels of a silhouette of known half sizes and offset [m]."""
    x, y = WIDTH / 2 + SCALE * right, HEIGHT / 2 - SCALE * up
    return np.array([x - SCALE * half_width, y - SCALE * half_height, x + SCALE * half_width, y + SCALE * half_height])


@pytest.mark.parametrize(
    ("kind", "size", "euler", "half_width", "half_height"),
    [
        ("sphere", "0.2", "0 0 0", 0.2, 0.2),
        ("capsule", "0.05 0.2", "0 90 0", 0.25, 0.05),  # along x, seen in full length
        ("capsule", "0.05 0.2", "90 0 0", 0.05, 0.05 + 0.2 * np.sin(np.radians(-ELEVATION))),  # along the view
    ],
)
def test_round_bodies_have_their_silhouette(kind, size, euler, half_width, half_height):
    found = colored_box(drawn(kind, size, euler=euler), 0)
    assert np.abs(found - around_middle(half_width, half_height)).max() <= 1.5


def test_a_box_is_the_projection_of_its_corners():
    a, b, c = 0.3, 0.1, 0.05
    e = np.radians(-ELEVATION)
    found = colored_box(drawn("box", f"{a} {b} {c}"), 0)
    assert np.abs(found - around_middle(a, b * np.sin(e) + c * np.cos(e))).max() <= 1.5


def test_a_body_is_drawn_where_it_is():
    found = colored_box(drawn("sphere", "0.1", pos="0.4 0 0.5"), 0)
    expected = around_middle(0.1, 0.1, right=0.4, up=0.2 * np.cos(np.radians(ELEVATION)))
    assert np.abs(found - expected).max() <= 1.5


def test_the_camera_is_mujocos():
    """Right, up and forward by the axes that MuJoCo gives its free camera."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    scene, camera, data = mujoco.MjvScene(model, 10), mujoco.MjvCamera(), mujoco.MjData(model)
    from agile_jax.report.video.camera import AZIMUTH

    camera.azimuth, camera.elevation, camera.distance = AZIMUTH, ELEVATION, 2.0
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    right, up, forward = axes_of_view()
    np.testing.assert_allclose(scene.camera[0].forward, forward, atol=1e-6)
    np.testing.assert_allclose(scene.camera[0].up, up, atol=1e-6)
    np.testing.assert_allclose(np.cross(forward, up), right, atol=1e-12)


@pytest.fixture(scope="module")
def robot_and_data(scene: Scene) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = build_mujoco_model(scene, RobotSettings(), 0.002)
    data = mujoco.MjData(model)
    data.qpos[:3] = [0.3, 0.1, 0.29]
    data.qpos[7:] = load_robot(RobotSettings()).home_joint_pos
    mujoco.mj_forward(model, data)
    return model, data


def robot_extent(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """[left, top, right, bottom] in pixels of the robot's visible geoms, from points sampled on their surfaces."""
    projection = Projection(np.array([0.3, 0.1, 0.25]), WIDTH, HEIGHT)
    generator = np.random.default_rng(0)
    sphere = generator.normal(size=(4000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    pixels = []
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] == 0 or model.geom_group[geom] > 2:
            continue
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            local = np.sign(sphere) * size
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            local = sphere * size[0] + np.sign(sphere[:, 2:]) * size[1] * [0, 0, 1]
        else:
            local = sphere * size[0]
        pixels.append(projection(data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T))
    cloud = np.concatenate(pixels)
    return np.concatenate([cloud.min(0), cloud.max(0)])


def test_the_robot_is_drawn_where_it_is(robot_and_data):
    model, data = robot_and_data
    look_at = np.array([0.3, 0.1, 0.25])
    with_robot = draw_frame(model, data, look_at, WIDTH, HEIGHT).astype(int)
    away = mujoco.MjData(model)
    away.qpos[:] = data.qpos
    away.qpos[0] += 50.0
    mujoco.mj_forward(model, away)
    changed = np.abs(with_robot - draw_frame(model, away, look_at, WIDTH, HEIGHT)).max(2) > 110  # shadows are fainter
    rows, columns = np.nonzero(changed)
    found = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    assert np.abs(found - robot_extent(model, data)).max() <= 3


def test_a_picture_takes_a_tenth_of_a_second(robot_and_data):
    model, data = robot_and_data
    times = []
    for _ in range(5):
        begun = time.process_time()
        draw_frame(model, data, np.array([0.3, 0.1, 0.25]), WIDTH, HEIGHT)
        times.append(time.process_time() - begun)
    assert min(times) < 0.1


def test_opengl_shows_the_robot_at_the_same_place(robot_and_data):
    """Two renderers, one robot: the perspective of the narrow camera moves edges by a few pixels only."""
    model, data = robot_and_data
    away = data.qpos.copy()
    away[0] += 50.0
    shot = Shot(np.stack([data.qpos, away]), np.tile([0.3, 0.1, 0.25], (2, 1)), ["", ""])
    for backend in ("egl", "osmesa"):
        try:
            here, gone = (frame.astype(int) for frame in opengl_frames(model, shot, WIDTH, HEIGHT, backend))
            break
        except RenderError:
            continue
    else:
        pytest.skip("this machine has no OpenGL")
    rows, columns = np.nonzero(np.abs(here - gone).max(2) > 60)
    found = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    assert np.abs(found - robot_extent(model, data)).max() <= 14
