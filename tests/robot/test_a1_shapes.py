"""The A1's collision shapes hold the published ones: how far surfaces of these stick out of the union of ours."""

import pathlib

import a1_published as published
import mujoco
import numpy as np
import pytest

from agile_jax.robot import RobotSettings
from agile_jax.robot.mjcf import robot_spec

MODEL = robot_spec(RobotSettings()).compile()
STANDS_OUT = 1e-3  # that a1.xml's comment allows [m]
ROUNDING = 5e-5  # of the numbers in it [m]
THIGH_BOX, THIGH_MESH, CALF_MESH = 4.9e-3, 4.4e-3, 6.8e-3  # the exceptions that it names, to 0.1 mm [m]
HIP_ANGLES = np.linspace(-1.0472, 4.18879, 25)  # of a thigh against its hip [rad]
KNEE_ANGLES = np.linspace(-2.69653, -0.916298, 25)


def surface(shape: published.Primitive) -> np.ndarray:
    """Points on a primitive, its edges among them, shape (n, 3) [m]."""
    start = np.array(shape.start, float)
    if shape.kind == "box":
        grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 13)] * 3), -1).reshape(-1, 3)
        return start + grid[(np.abs(grid) == 1).any(-1)] * shape.size
    end, radius = np.array(shape.end, float), shape.size[0]
    z = (end - start) / np.linalg.norm(end - start) if (end != start).any() else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.5 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    round_ = np.outer(np.cos(turn), x) + np.outer(np.sin(turn), np.cross(z, x))
    rings = [start + share * (end - start) + radius * round_ for share in np.linspace(0, 1, 25)]
    if shape.kind == "capsule":
        for tilt in np.linspace(0, np.pi / 2, 13):
            for centre, sign in ((start, -1), (end, 1)):
                rings.append(centre + radius * (np.cos(tilt) * round_ + sign * np.sin(tilt) * z))
    return np.concatenate(rings)


def distance(bodies: dict[str, np.ndarray], least: int = 1) -> np.ndarray:
    """How far points stick out of what collides of bodies; each is given in that body's frame, shape (n, 3) [m]."""
    found = []
    for body, points in bodies.items():
        for geom in np.flatnonzero((MODEL.geom_bodyid == MODEL.body(body).id) & (MODEL.geom_conaffinity & 2 > 0)):
            turned = np.empty(9)
            mujoco.mju_quat2Mat(turned, MODEL.geom_quat[geom])
            local, size = (points - MODEL.geom_pos[geom]) @ turned.reshape(3, 3), MODEL.geom_size[geom]
            if MODEL.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
                found.append(np.linalg.norm(np.maximum(np.abs(local) - size, 0.0), axis=-1))
                continue
            length = size[1] if MODEL.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
            axial = local[:, 2] - np.clip(local[:, 2], -length, length)
            found.append(np.maximum(np.sqrt((local[:, :2] ** 2).sum(-1) + axial**2) - size[0], 0.0))
    assert len(found) >= least
    return np.min(found, 0)


def about_y(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T


def sticks_out(link: str, points: np.ndarray, leg: str) -> float:
    """The largest distance of points of a link [m]; of thigh and calf at every angle to the link that they hang on."""
    if link == "trunk":
        return float(distance({"trunk": points}).max())
    if link == "hip":
        return float(distance({f"{leg}_hip": points}).max())
    parent, angles = {"thigh": ("hip", HIP_ANGLES), "calf": ("thigh", KNEE_ANGLES)}[link]
    own, offset = f"{leg}_{link}", MODEL.body(f"{leg}_{link}").pos
    return max(
        float(distance({own: points, f"{leg}_{parent}": offset + about_y(points, angle)}, 3).max()) for angle in angles
    )


@pytest.mark.parametrize("shape", published.PRIMITIVES, ids=lambda one: f"[{one.source}] {one.link} {one.kind}")
def test_published_primitives_are_covered(shape: published.Primitive):
    allowed = THIGH_BOX if (shape.link, shape.kind) == ("thigh", "box") else STANDS_OUT
    for leg in ("FR", "FL", "RR", "RL"):
        mirror = np.array([1.0, 1.0 if leg.endswith("L") or shape.link == "trunk" else -1.0, 1.0])
        assert sticks_out(shape.link, surface(shape) * mirror, leg) <= allowed + ROUNDING


@pytest.mark.parametrize(
    ("mesh", "link", "leg", "turn", "allowed"),
    [
        ("trunk", "trunk", "", (1, 1, 1), STANDS_OUT),
        ("hip", "hip", "FL", (1, 1, 1), STANDS_OUT),
        ("hip", "hip", "FR", (1, -1, -1), STANDS_OUT),
        ("hip", "hip", "RL", (-1, 1, -1), STANDS_OUT),
        ("hip", "hip", "RR", (-1, -1, 1), STANDS_OUT),
        ("thigh", "thigh", "FL", (1, 1, 1), THIGH_MESH),
        ("thigh_mirror", "thigh", "RR", (1, 1, 1), THIGH_MESH),
        ("calf", "calf", "FL", (1, 1, 1), CALF_MESH),
    ],
)
def test_published_meshes_are_covered(mesh: str, link: str, leg: str, turn: tuple[int, int, int], allowed: float):
    """Those of PyBullet's data, as unitree_ros places them: the vertices that faces use."""
    data = pytest.importorskip("pybullet_data")
    lines = (pathlib.Path(data.getDataPath()) / f"a1/meshes/{mesh}.obj").read_text().splitlines()
    vertices = np.array([[float(word) for word in line.split()[1:4]] for line in lines if line.startswith("v ")])
    used = {int(word.split("/")[0]) - 1 for line in lines if line.startswith("f ") for word in line.split()[1:]}
    assert sticks_out(link, vertices[sorted(used)] * turn, leg) <= allowed + ROUNDING


def test_what_covers_is_not_much_larger_than_what_it_covers():
    """Of the whole body at zero angles, along each axis: the published one is the hull of primitives."""
    reach = np.abs(np.concatenate([surface(one) for one in published.PRIMITIVES if one.link == "trunk"])).max(0)
    box = MODEL.geom("trunk_body")
    assert ((np.abs(box.pos) + box.size - reach) < [0.005, 0.0015, 0.0005]).all()
