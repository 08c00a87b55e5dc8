"""A renderer that needs no OpenGL: the model's own boxes, capsules and spheres, painted from far to near.

The projection is orthographic, in which a sphere is a circle, a capsule the hull of two circles and a box the
polygons of its faces that look at the camera. Obstacles are translucent, so that the robot below them stays visible.
"""

from collections.abc import Iterator

import mujoco
import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw
from scipy.spatial import ConvexHull

from agile_jax.report.video.camera import SEE_THROUGH, VIEW_HEIGHT, Picture, Shot, axes_of_view

_GEOM = mujoco.mjtGeom
_PLANE, _BOX = int(_GEOM.mjGEOM_PLANE), int(_GEOM.mjGEOM_BOX)
_SPHERE, _CAPSULE = int(_GEOM.mjGEOM_SPHERE), int(_GEOM.mjGEOM_CAPSULE)
_SAMPLES = 2  # the picture is drawn this much larger and then reduced, against jagged edges
_SKY, _FLOOR, _LINE = (244, 247, 250), (223, 226, 228), (205, 209, 212)
_LIGHT = np.array([-0.35, -0.6, 0.72])
_FACES = [(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]


class Projection:
    """Maps the world to the pixels of one picture, orthographically."""

    def __init__(self, look_at: Float[np.ndarray, "3"], width: int, height: int):
        """`look_at` [m] is in the middle of `width` x `height` [pixel]."""
        self.right, self.up, self.forward = axes_of_view()
        self.look_at, self.size = look_at, np.array([width, height])
        self.scale = height / VIEW_HEIGHT  # [pixel/m]

    def __call__(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Pixels, right and down, of points [m]."""
        local = points - self.look_at
        return self.size / 2 + self.scale * np.stack([local @ self.right, -(local @ self.up)], -1)

    def depth(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Distance along the view [m]."""
        return (points - self.look_at) @ self.forward


def drawn_frames(model: mujoco.MjModel, shot: Shot, width: int, height: int) -> Iterator[Picture]:
    """The pictures of a shot.

    Geoms of kinds other than box, capsule, sphere and plane are left out; planes are the floor at z = 0.
    """
    data = mujoco.MjData(model)
    for qpos, look_at in zip(shot.qpos, shot.look_at, strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        yield draw_frame(model, data, look_at, width, height)


def draw_frame(
    model: mujoco.MjModel, data: mujoco.MjData, look_at: Float[np.ndarray, "3"], width: int, height: int
) -> Picture:
    """One picture of the model as `data` has it (after kinematics)."""
    projection = Projection(look_at, width * _SAMPLES, height * _SAMPLES)
    image = Image.new("RGB", (width * _SAMPLES, height * _SAMPLES), _SKY)
    pen = ImageDraw.Draw(image, "RGBA")  # this mode blends translucent colours
    _draw_floor(pen, projection)
    shown = [geom for geom in range(model.ngeom) if _is_shown(model, geom)]
    far_to_near = [shown[i] for i in np.argsort(-projection.depth(data.geom_xpos[shown]), kind="stable")]
    fixed = [geom for geom in far_to_near if model.geom_bodyid[geom] == 0]
    moving = [geom for geom in far_to_near if model.geom_bodyid[geom] != 0]
    for geom in fixed:
        _draw_geom(pen, projection, model, data, geom, front=False)
    for geom in moving:
        _draw_shadow(pen, projection, model, data, geom)
    for geom in moving:
        _draw_geom(pen, projection, model, data, geom, front=True)
    for geom in fixed:
        _draw_geom(pen, projection, model, data, geom, front=True)
    return np.asarray(image.reduce(_SAMPLES))


def _is_shown(model: mujoco.MjModel, geom: int) -> bool:
    """Groups 3 to 5 are those that MuJoCo's own viewers hide."""
    return bool(model.geom_type[geom] != _PLANE and model.geom_group[geom] <= 2 and model.geom_rgba[geom, 3] > 0)


def _draw_floor(pen: ImageDraw.ImageDraw, projection: Projection) -> None:
    x, y = np.round(projection.look_at[:2])
    corners = np.array([[x - 6, y - 8, 0], [x + 6, y - 8, 0], [x + 6, y + 4, 0], [x - 6, y + 4, 0]], float)
    pen.polygon(_pixels(projection(corners)), fill=_FLOOR)
    for offset in np.arange(-6, 6.01, 0.25):
        pen.line(_pixels(projection(np.array([[x + offset, y - 8, 0], [x + offset, y + 4, 0]]))), fill=_LINE, width=2)
    for offset in np.arange(-8, 4.01, 0.5):
        pen.line(_pixels(projection(np.array([[x - 6, y + offset, 0], [x + 6, y + offset, 0]]))), fill=_LINE, width=2)


def _draw_shadow(
    pen: ImageDraw.ImageDraw, projection: Projection, model: mujoco.MjModel, data: mujoco.MjData, geom: int
) -> None:
    """The geom's axis, straight down on the floor: it shows which feet are in the air."""
    size, center, rotation = model.geom_size[geom], data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    kind = model.geom_type[geom]
    if kind == _BOX:
        along, radius = rotation[:, 0] * size[0], size[1]
    elif kind == _CAPSULE:
        along, radius = rotation[:, 2] * size[1], size[0]
    else:
        along, radius = np.zeros(3), size[0]
    ends = np.stack([center - along, center + along]) * [1.0, 1.0, 0.0]
    flat = np.array([[radius, 0, 0], [0, radius, 0]])
    corners = np.concatenate([ends[0] - flat, ends[0] + flat, ends[1] - flat, ends[1] + flat])
    outline = projection(corners)
    pen.polygon(_pixels(outline[ConvexHull(outline).vertices]), fill=(60, 60, 70, 26))


def _draw_geom(
    pen: ImageDraw.ImageDraw,
    projection: Projection,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geom: int,
    front: bool,
) -> None:
    """Draw a geom; of a box only the faces that look at the camera (`front`) or only the others."""
    size, center, rotation = model.geom_size[geom], data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    material, kind = model.geom_matid[geom], model.geom_type[geom]
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    rgb, alpha = rgba[:3], float(rgba[3]) if model.geom_bodyid[geom] else min(float(rgba[3]), SEE_THROUGH)
    if kind == _BOX:
        for axis, sign in _FACES:
            normal = sign * rotation[:, axis]
            if (normal @ projection.forward < 0) != front:
                continue
            first, second = (axis + 1) % 3, (axis + 2) % 3
            u, v = rotation[:, first] * size[first], rotation[:, second] * size[second]
            middle = center + normal * size[axis]
            corners = np.stack([middle + u + v, middle - u + v, middle - u - v, middle + u - v])
            fill, edge = _shade(rgb, normal, alpha)
            pen.polygon(_pixels(projection(corners)), fill=fill, outline=edge)
        return
    if not front or kind not in (_CAPSULE, _SPHERE):
        return
    along = rotation[:, 2] * size[1] if kind == _CAPSULE else np.zeros(3)
    ends = projection(np.stack([center - along, center + along]))
    fill, edge = _shade(rgb, _facing(projection, along), alpha)
    radius = size[0] * projection.scale
    pen.polygon(_pixels(_stadium(ends, radius)), fill=fill, outline=edge)


def _stadium(ends: Float[np.ndarray, "2 2"], radius: float) -> Float[np.ndarray, "n 2"]:
    """Outline of the hull of two circles of equal radius around the ends."""
    direction = ends[1] - ends[0]
    start = np.arctan2(direction[1], direction[0]) + np.pi / 2
    angles = start + np.linspace(0.0, np.pi, 13)
    cap = radius * np.stack([np.cos(angles), np.sin(angles)], -1)
    return np.concatenate([ends[0] + cap, ends[1] - cap])


def _facing(projection: Projection, along: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The normal of a round body at the line that faces the camera."""
    length = np.linalg.norm(along)
    toward = -projection.forward
    if length > 0:
        toward = toward - (toward @ along) * along / length**2
    return toward / max(float(np.linalg.norm(toward)), 1e-9)


def _shade(
    rgb: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"], alpha: float
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Fill and outline of a surface: diffuse light and a darker edge."""
    light = 0.72 + 0.28 * float(normal @ _LIGHT / np.linalg.norm(_LIGHT))
    fill = np.clip(255 * rgb * light, 0, 255)
    opacity = int(255 * alpha)
    return (*(int(c) for c in fill), opacity), (*(int(0.55 * c) for c in fill), opacity)


def _pixels(points: Float[np.ndarray, "n 2"]) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in points]
