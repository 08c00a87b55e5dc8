"""The model of the scene: what collides with what, where the obstacles stand, and what the torso's envelope covers."""

import mujoco
import numpy as np
import pytest

from agile_jax.robot import IMAGE_SIZE, LEG_NAMES, RobotSettings, build_mujoco_model, load_robot, standing_qpos
from agile_jax.scene import BoxSettings, SceneSettings, TableSettings, make_scene

TABLE = TableSettings(kind="table", position=(1.5, 0.2), size=(0.5, 1.0), underside=0.25, yaw=0.3)
BOX = BoxSettings(kind="box", position=(0.0, 1.2, 0.1), size=(0.2, 0.3, 0.2), yaw=-0.5)
SCENE = make_scene(SceneSettings(obstacles=(TABLE, BOX)))
MODEL = build_mujoco_model(SCENE, RobotSettings(), 0.001)
ROBOT = load_robot(RobotSettings())
BODY_GEOMS = ["trunk_body", *(f"{leg}_{part}" for leg in LEG_NAMES for part in ("hip", "thigh", "thigh_back"))]
LEG_GEOMS = [f"{leg}_{part}" for leg in LEG_NAMES for part in ("calf", "foot")]
COLLISION_GEOMS = set(BODY_GEOMS + LEG_GEOMS)


def touching(model, qpos) -> set[tuple[str, str]]:
    """Pairs of names (what stands, part of the robot) in contact."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    pairs = [sorted(model.geom(geom).name for geom in contact) for contact in data.contact.geom]
    fixed = ("floor", "obstacle_")
    return {(a, b) if a.startswith(fixed) else (b, a) for a, b in pairs}


def test_options():
    assert MODEL.opt.timestep == 0.001
    assert MODEL.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert (MODEL.vis.global_.offwidth, MODEL.vis.global_.offheight) == IMAGE_SIZE
    assert {MODEL.camera(index).name for index in range(MODEL.ncam)} == {"side", "front", "track"}


LEGGED = TABLE.model_copy(update={"leg_size": (0.06, 0.06), "leg_inset": 0.02})
THIN = TABLE.model_copy(update={"underside": 0.3, "top": 0.32, "yaw": 0.0})  # no more than a board


def inside(model, geoms: list[int], points: np.ndarray, margin: float) -> np.ndarray:
    """Whether each point (n, 3) is in one of the boxes, enlarged by a margin [m]."""
    local = [(points - model.geom_pos[geom]) @ matrix_of(model.geom_quat[geom]) for geom in geoms]
    found = [(np.abs(at) <= model.geom_size[geom] + margin).all(-1) for geom, at in zip(geoms, local, strict=True)]
    return np.any(found, axis=0)


def matrix_of(quat: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


@pytest.mark.parametrize("obstacle", [TABLE, LEGGED, THIN, BOX], ids=["table", "legs", "board", "box"])
def test_what_is_seen_of_an_obstacle_is_what_collides(obstacle):
    """To a millimetre, both ways: nothing is drawn that does not collide, and nothing collides unseen."""
    model = build_mujoco_model(make_scene(SceneSettings(obstacles=(obstacle,))), RobotSettings(), 0.001)
    still = [
        g for g in range(model.ngeom) if model.geom_bodyid[g] == 0 and model.geom(g).name not in ("floor", "target")
    ]
    assert {int(model.geom_type[geom]) for geom in still} == {int(mujoco.mjtGeom.mjGEOM_BOX)}
    solid = [geom for geom in still if model.geom_contype[geom]]
    seen = [geom for geom in still if model.geom_rgba[geom, 3] > 0 and model.geom_group[geom] <= 2]
    unit = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3), -1).reshape(-1, 3)
    for mine, others in ((seen, solid), (solid, seen)):
        for geom in mine:
            points = model.geom_pos[geom] + (unit * model.geom_size[geom]) @ matrix_of(model.geom_quat[geom]).T
            assert inside(model, others, points, 1e-3).all()


def test_a_slab_is_seen_as_a_board_with_a_fainter_rest():
    opacity = [float(MODEL.geom_rgba[geom, 3]) for geom in range(MODEL.ngeom) if MODEL.geom_bodyid[geom] == 0]
    board, rest = opacity[2:4]  # after the floor and the box that collides
    assert board == 1.0
    assert 0.0 < rest < 0.3


def test_a_tables_legs_collide_where_it_has_any():
    scene = make_scene(SceneSettings(obstacles=(TABLE.model_copy(update={"leg_size": (0.06, 0.06)}), BOX)))
    model = build_mujoco_model(scene, RobotSettings(), 0.001)
    assert model.ngeom == MODEL.ngeom + 4
    for index in range(6):
        geom = model.geom(f"obstacle_{index}")
        np.testing.assert_allclose(geom.pos, scene.obstacle_centers[index])
        np.testing.assert_allclose(geom.size, scene.obstacle_half_sizes[index])
    x, y, _ = scene.obstacle_centers[3]
    through = touching(model, standing_qpos(ROBOT, np.array([x, y, 0.17, 0.3])))
    assert ("obstacle_3", "trunk_body") in through
    between = touching(model, standing_qpos(ROBOT, np.array([1.5, 0.2, 0.17, 0.3])))
    assert not {pair for pair in between if pair[0].startswith("obstacle_")}


def test_obstacles_are_the_scenes():
    for index in range(2):
        geom = MODEL.geom(f"obstacle_{index}")
        np.testing.assert_allclose(geom.pos, SCENE.obstacle_centers[index])
        np.testing.assert_allclose(geom.size, SCENE.obstacle_half_sizes[index])
        yaw = SCENE.obstacle_yaws[index]
        np.testing.assert_allclose(geom.quat, [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


def test_an_empty_scene_has_no_obstacle():
    model = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), 0.002)
    assert not [index for index in range(model.ngeom) if model.geom(index).name.startswith("obstacle_")]


def test_only_shapes_that_mjx_can_collide():
    solid = [geom for geom in range(MODEL.ngeom) if MODEL.geom_contype[geom] or MODEL.geom_conaffinity[geom] & 3]
    kinds = mujoco.mjtGeom
    allowed = {kinds.mjGEOM_PLANE, kinds.mjGEOM_BOX, kinds.mjGEOM_CAPSULE, kinds.mjGEOM_SPHERE}
    assert {int(MODEL.geom_type[geom]) for geom in solid} <= {int(kind) for kind in allowed}
    names = {MODEL.geom(geom).name for geom in solid}
    assert names == COLLISION_GEOMS | {"floor", "obstacle_0", "obstacle_1"}


def test_every_part_of_the_robot_collides_with_obstacles():
    block = BoxSettings(kind="box", position=(0.0, 0.0, 2.0), size=(2.0, 2.0, 2.0))
    model = build_mujoco_model(make_scene(SceneSettings(obstacles=(block,))), RobotSettings(), 0.002)
    qpos = [0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, *ROBOT.home_joint_pos]
    assert touching(model, qpos) == {("obstacle_0", name) for name in COLLISION_GEOMS}


def test_all_but_the_calves_collide_with_the_floor():
    qpos = [0.0, -2.0, -0.4, 1.0, 0.0, 0.0, 0.0, *ROBOT.home_joint_pos]  # the whole robot is below the floor
    calves = {f"{leg}_calf" for leg in LEG_NAMES}
    assert touching(MODEL, qpos) == {("floor", name) for name in COLLISION_GEOMS - calves}


def test_the_robot_does_not_collide_with_itself():
    generator = np.random.default_rng(0)
    for _ in range(50):
        joint_pos = generator.uniform(ROBOT.joint_lower, ROBOT.joint_upper)
        assert not touching(MODEL, [0.0, -2.0, 2.0, 1.0, 0.0, 0.0, 0.0, *joint_pos])


def test_standing_robot_touches_the_floor_with_its_feet_only():
    qpos = np.array(standing_qpos(ROBOT, np.array([0.0, -1.0, 0.25, 0.0])))
    qpos[2] -= 1e-4
    assert touching(MODEL, qpos) == {("floor", f"{leg}_foot") for leg in LEG_NAMES}


def test_feet_carry_the_weight():
    data = mujoco.MjData(MODEL)
    data.qpos[:] = target = np.array(standing_qpos(ROBOT, np.array([0.0, -1.0, 0.27, 0.0])))
    for _ in range(2000):
        data.ctrl[:] = 200.0 * (target[7:] - data.qpos[7:]) - 3.0 * data.qvel[6:]
        mujoco.mj_step(MODEL, data)
    normal = np.zeros(6)
    total = 0.0
    for index in range(data.ncon):
        mujoco.mj_contactForce(MODEL, data, index, normal)
        total += normal[0]
    assert abs(data.qvel).max() < 1e-2
    assert total == pytest.approx(12.453 * 9.81, rel=1e-3)


def extent(data, name) -> np.ndarray:
    """Largest reach of a collision geom from the trunk's origin along the world's axes (3,) [m]."""
    geom = MODEL.geom(name)
    center, axes = np.abs(data.geom(name).xpos), data.geom(name).xmat.reshape(3, 3)
    if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
        return center + np.abs(axes) @ geom.size
    half_length = geom.size[1] if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    return center + np.abs(axes[:, 2]) * half_length + geom.size[0]


@pytest.mark.parametrize("height", [0.15, 0.18, 0.27, 0.32])
def test_the_scenes_torso_envelope_covers_trunk_hips_and_thigh_roots(height):
    """What is level with the trunk must be inside the box whose clearance the planner keeps."""
    data = mujoco.MjData(MODEL)
    data.qpos[:] = standing_qpos(ROBOT, np.array([0.0, 0.0, height, 0.0]))
    data.qpos[:3] = 0.0
    mujoco.mj_forward(MODEL, data)
    reach = [extent(data, name) for name in ["trunk_body", *(f"{leg}_hip" for leg in LEG_NAMES)]]
    for leg in LEG_NAMES:
        body = MODEL.body(f"{leg}_thigh").id
        for name in ("thigh", "thigh_back"):
            thigh = MODEL.geom(f"{leg}_{name}")
            root = data.xpos[body] + data.xmat[body].reshape(3, 3) @ [thigh.pos[0], 0.0, 0.0]
            reach.append(np.abs(root) + thigh.size[0])
    largest = np.max(reach, 0)
    np.testing.assert_allclose(largest, [0.28, 0.15455, 0.058], atol=1e-5)
    assert (largest <= np.array(SceneSettings().torso_half_size) + 1e-9).all()
