"""The robot in its scene as a MuJoCo model: one model for MuJoCo C, MJX and rendering."""

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.geometry import wrap_angle, yaw_to_quaternion
from agile_jax.robot.constants import LEG_NAMES
from agile_jax.robot.kinematics import leg_inverse_kinematics
from agile_jax.robot.mjcf import robot_spec
from agile_jax.robot.model import RobotModel
from agile_jax.robot.settings import RobotSettings
from agile_jax.scene import Scene

FLOOR_BIT, OBSTACLE_BIT = 1, 2  # contype of what stands in the scene; the robot's conaffinity chooses among them
OBSTACLE_PREFIX = "obstacle_"
TOUCH_OBSTACLE_PREFIX = "touch_obstacle_"
TOUCH_FLOOR_PREFIX = "touch_floor_"
TOUCH_FOOT_PREFIX = "touch_foot_"
VISUAL_GROUP = 2
IMAGE_SIZE = (1280, 720)  # largest picture that can be rendered off screen [pixels]
BOARD = 0.03  # what is seen of a slab as its board [m]
_GLASS = [0.55, 0.38, 0.22, 0.10]
_UNSEEN = [0.0, 0.0, 0.0, 0.0]
_WOOD = [0.55, 0.38, 0.22, 1.0]
_TARGET = [0.15, 0.75, 0.30, 0.20]


def build_mujoco_model(scene: Scene, settings: RobotSettings, sim_dt: float) -> mujoco.MjModel:
    """Floor, obstacles, robot, light and cameras.

    The obstacles' boxes are geoms `obstacle_0`, ...; the floor is `floor`; `target` shows the torso's envelope at the
    target, which is no obstacle; cameras are `side`, `front` and `track` (follows the trunk). What is seen of the
    obstacles is what collides. The robot collides with the floor and with obstacles, never with itself; automatic
    reset is off. Contact sensors count what must not happen: `touch_obstacle_0`, ... (any part of the robot on that
    box) and `touch_floor_<geom>` (trunk, hips, thighs). Others are the robot's feeling: `touch_foot_<leg>`, whatever
    it touches.

    Args:
        scene: obstacles and target.
        settings: the robot.
        sim_dt: time step of the physics [s].
    """
    spec = robot_spec(settings)
    spec.option.timestep = sim_dt
    spec.visual.global_.offwidth, spec.visual.global_.offheight = IMAGE_SIZE
    _add_floor_and_light(spec)
    for index in range(len(scene.obstacle_centers)):
        _add_obstacle(spec, scene, index)
    _add_target(spec, scene)
    _add_cameras(spec, scene)
    _add_touch_sensors(spec, len(scene.obstacle_centers))
    spec.memory = 4 << 20
    return spec.compile()


def standing_qpos(model: RobotModel, pose: Float[AnyArray, "4"]) -> Float[Array, "19"]:
    """Coordinates of the robot standing still: the trunk at `pose`, level, the feet on the floor under the hips.

    Args:
        model: the robot.
        pose: [x, y, z, yaw] of the trunk [m, rad]; vmap at the caller.

    Returns:
        The coordinates `qpos`.
    """
    pose = jnp.asarray(pose)
    feet = jnp.asarray(model.hip_pos_base) + jnp.outer(jnp.asarray(model.abad_offset), jnp.array([0.0, 1.0, 0.0]))
    feet = feet.at[:, 2].set(model.foot_radius - pose[2])
    quat = yaw_to_quaternion(wrap_angle(pose[3], jnp), jnp)
    return jnp.concatenate([pose[:3], quat, leg_inverse_kinematics(model, feet)])


def _visual(spec: mujoco.MjSpec, kind: mujoco.mjtGeom, **attributes: object) -> None:
    spec.worldbody.add_geom(type=kind, contype=0, conaffinity=0, group=VISUAL_GROUP, **attributes)


def _add_floor_and_light(spec: mujoco.MjSpec) -> None:
    kinds, patterns = mujoco.mjtTexture, mujoco.mjtBuiltin
    for name, kind, pattern, first, second in (
        ("sky", kinds.mjTEXTURE_SKYBOX, patterns.mjBUILTIN_GRADIENT, [0.75, 0.82, 0.90], [0.95, 0.97, 1.0]),
        ("checker", kinds.mjTEXTURE_2D, patterns.mjBUILTIN_CHECKER, [0.80, 0.82, 0.84], [0.70, 0.72, 0.75]),
    ):
        spec.add_texture(name=name, type=kind, builtin=pattern, rgb1=first, rgb2=second, width=256, height=256)
    floor = spec.add_material(name="floor", texrepeat=[2.0, 2.0], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "checker"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 0.05],
        material="floor",
        contype=FLOOR_BIT,
        conaffinity=0,
        condim=1,
    )
    spec.worldbody.add_light(
        pos=[0.0, -2.0, 5.0],
        dir=[0.1, 0.35, -0.93],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.6, 0.6, 0.6],
        castshadow=True,
    )
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    spec.visual.quality.shadowsize = 2048


def _add_obstacle(spec: mujoco.MjSpec, scene: Scene, index: int) -> None:
    """The box that collides, which is also what is seen; a slab over the floor is seen as a board and, fainter, the
    rest of what it blocks above."""
    center, half = scene.obstacle_centers[index], scene.obstacle_half_sizes[index]
    quat = yaw_to_quaternion(scene.obstacle_yaws[index])
    hangs = center[2] - half[2] > 0.02
    spec.worldbody.add_geom(
        name=f"{OBSTACLE_PREFIX}{index}",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=center,
        size=half,
        quat=quat,
        rgba=_UNSEEN if hangs else _WOOD,
        contype=OBSTACLE_BIT,
        conaffinity=0,
        condim=1,
    )
    if not hangs:
        return
    board = min(BOARD / 2, half[2])
    for color, height, middle in (
        (_WOOD, board, center[2] - half[2] + board),
        (_GLASS, half[2] - board, center[2] + board),
    ):
        if height > 0:
            _visual(
                spec,
                mujoco.mjtGeom.mjGEOM_BOX,
                pos=[*center[:2], middle],
                size=[*half[:2], height],
                quat=quat,
                rgba=color,
            )


def _add_target(spec: mujoco.MjSpec, scene: Scene) -> None:
    x, y, z, yaw = scene.target
    _visual(
        spec,
        mujoco.mjtGeom.mjGEOM_BOX,
        name="target",
        pos=[x, y, z],
        size=scene.torso_half_size,
        quat=yaw_to_quaternion(yaw),
        rgba=_TARGET,
    )


def _add_cameras(spec: mujoco.MjSpec, scene: Scene) -> None:
    places = np.concatenate([scene.obstacle_centers[:, :2], scene.target[None, :2], np.zeros((1, 2))])
    middle = np.array([*(places.min(0) + places.max(0)) / 2, 0.2])
    length = max(np.ptp(places[:, 0]), 2.0)
    end = np.array([places[:, 0].max(), middle[1], 0.2])
    for name, eye, look_at in (
        ("side", middle + np.array([0.0, -1.2 * length, 0.1 * length]), middle + np.array([0.0, 0.0, 0.1])),
        ("front", end + np.array([1.2, -0.9, 0.5]), end - np.array([1.2, 0.0, 0.0])),
    ):
        spec.worldbody.add_camera(name=name, pos=eye, xyaxes=_look_at(eye, look_at), fovy=35)
    offset = np.array([0.6, -1.5, 0.25])
    spec.body("trunk").add_camera(
        name="track",
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM,
        pos=offset,
        xyaxes=_look_at(offset, np.zeros(3)),
        fovy=45,
    )


def _add_touch_sensors(spec: mujoco.MjSpec, obstacles: int) -> None:
    """Sensors, and not the list of contacts, because they are the same in MuJoCo C, in MJX and in mujoco.rollout."""

    def add(name: str, geom: str, **other: object) -> None:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=geom,
            intprm=[1, 0, 1],  # data "found", no reduction, one slot
            **other,
        )

    for index in range(obstacles):
        add(TOUCH_OBSTACLE_PREFIX + str(index), OBSTACLE_PREFIX + str(index))
    for leg in LEG_NAMES:
        add(TOUCH_FOOT_PREFIX + leg, f"{leg}_foot")
    for geom in spec.geoms:
        if geom.conaffinity & FLOOR_BIT and not geom.name.endswith("_foot"):
            add(
                TOUCH_FLOOR_PREFIX + geom.name,
                "floor",
                reftype=mujoco.mjtObj.mjOBJ_GEOM,
                refname=geom.name,
            )


def _look_at(eye: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Image axes right and up, in the world, of an upright camera at `eye` (3,) looking at `point` (3,). Shape (6,)."""
    back = (eye - point) / np.linalg.norm(eye - point)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return np.concatenate([right, np.cross(back, right)])
