"""A robot as a URDF, written from its compiled MuJoCo model: the same masses, inertias, joints, limits and shapes.

A URDF has no armature. What MuJoCo adds to a joint's inertia is the rotor of its motor, which turns `GEAR` times as
fast as the joint. Here it is a link beside the joint, hinged to the same parent about the same axis, with the inertia
armature / GEAR^2; the physics has to gear it to the joint. It has no mass, and its inertia is taken off its parent, so
that with its rotors held still the robot is that of the model (but where a file says that a link has less than its
rotors, as those of Go2 and Aliengo do: it keeps its own). The rotors' reaction on their parents, which MuJoCo leaves
out, is there. To leave it out, too, rotors can be hinged to the world instead (`write_rotors`).

A foot is a link of its own, fixed to its calf, because it has a friction of its own. Its mass is part of the calf's.
"""

import pathlib
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
from jaxtyping import Float

from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot.mujoco_model import OBSTACLE_BIT
from agile_jax.settings import BadInput

# Turns of a rotor for one of its joint, the same way round: the A1's planetary gears. The inertia that a joint feels
# does not depend on it; the reaction on the link that carries the rotor does, as armature / GEAR.
GEAR = 9.0
ROTOR, FOOT = "_rotor", "_foot"  # ends of the names of rotors and feet
_UNBOUNDED = 1e6  # effort [Nm] and velocity [rad/s] that a URDF must state; the torques' limits are the caller's


def write_urdf(model: mujoco.MjModel, folder: pathlib.Path, rotors: bool = True) -> pathlib.Path:
    """Write the robot's URDF, and its meshes, into a folder.

    Args:
        model: from `robot.build_mujoco_model`; its scene is left out.
        folder: that is there.
        rotors: whether the robot carries them.

    Returns:
        The URDF's path.

    Raises:
        BadInput: a shape has no counterpart in a URDF.
    """
    robot = Xml.Element("robot", name="robot")
    for body in range(1, model.nbody):
        inertia = _inertia(model, body, rotors)
        link = _link(robot, model.body(body).name, model.body_mass[body], model.body_ipos[body], inertia)
        for geom in np.flatnonzero((model.geom_bodyid == body) & (model.geom_conaffinity & OBSTACLE_BIT > 0)).tolist():
            if model.geom(geom).name.endswith(FOOT):
                link_of_foot = _link(robot, model.geom(geom).name, 0.0, np.zeros(3), np.zeros((3, 3)))
                _shape(link_of_foot, model, geom, np.zeros(3), folder)
                _joint(robot, model.body(body).name, model.geom(geom).name, model.geom_pos[geom])
            else:
                _shape(link, model, geom, model.geom_pos[geom], folder)
    for joint in range(1, model.njnt):  # the first is the trunk's
        body = int(model.jnt_bodyid[joint])
        parent, child = model.body(model.body_parentid[body]).name, model.body(body).name
        _joint(robot, parent, child, model.body_pos[body], model, joint)
        if rotors:
            _rotor(robot, parent, model, joint)
    return _written(robot, folder)


def write_rotors(model: mujoco.MjModel, folder: pathlib.Path) -> pathlib.Path:
    """Write the URDF of the robot's rotors, all on one base, into a folder; its path."""
    rotors = Xml.Element("robot", name="rotors")
    _link(rotors, "base", 1.0, np.zeros(3), np.eye(3))
    for joint in range(1, model.njnt):
        _rotor(rotors, "base", model, joint)
    return _written(rotors, folder)


def _written(robot: Xml.Element, folder: pathlib.Path) -> pathlib.Path:
    Xml.indent(robot)
    path = folder / f"{robot.get('name')}.urdf"
    path.write_text(Xml.tostring(robot, encoding="unicode"))
    return path


def _rotor(robot: Xml.Element, parent: str, model: mujoco.MjModel, joint: int) -> None:
    """The rotor of a joint, if there is one."""
    if inertia := _rotor_inertia(model, joint):
        name = model.joint(joint).name + ROTOR
        _link(robot, name, 0.0, np.zeros(3), inertia * np.eye(3))
        _joint(robot, parent, name, model.body_pos[model.jnt_bodyid[joint]], model, joint, limited=False)


def _rotor_inertia(model: mujoco.MjModel, joint: int) -> float:
    """About the axis of a joint [kg m^2]."""
    return float(model.dof_armature[model.jnt_dofadr[joint]]) / GEAR**2


def _inertia(model: mujoco.MjModel, body: int, rotors: bool) -> Float[np.ndarray, "3 3"]:
    """About a link's centre of mass, along the link's axes, without the rotors that it carries [kg m^2]."""
    axes = quaternion_to_matrix(model.body_iquat[body])
    own: np.ndarray = axes * model.body_inertia[body] @ axes.T
    here = [joint for joint in range(1, model.njnt) if model.body_parentid[model.jnt_bodyid[joint]] == body]
    carried = np.sum([_rotor_inertia(model, joint) for joint in here]) if rotors else 0.0
    rest: np.ndarray = own - carried * np.eye(3)
    least, middle, most = np.linalg.eigvalsh(rest)
    return rest if least > 0 and most <= least + middle else own


def _link(
    robot: Xml.Element, name: str, mass: float, center: Float[np.ndarray, "3"], inertia: Float[np.ndarray, "3 3"]
) -> Xml.Element:
    """A link with its inertia along its principal axes, which Bullet would find with six digits only."""
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)  # a rotation
    moments[2] = min(moments[2], moments[0] + moments[1])  # rounding; Bullet would take more for an error, and zero
    link = Xml.SubElement(robot, "link", name=name)
    inertial = Xml.SubElement(link, "inertial")
    _origin(inertial, center, axes)
    Xml.SubElement(inertial, "mass", value=repr(float(mass)))
    values = dict(zip(("ixx", "iyy", "izz"), map(repr, moments.tolist()), strict=True))
    Xml.SubElement(inertial, "inertia", values | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
    return link


def _joint(
    robot: Xml.Element,
    parent: str,
    child: str,
    pos: Float[np.ndarray, "3"],
    model: mujoco.MjModel | None = None,
    joint: int = 0,
    limited: bool = True,
) -> None:
    """A fixed joint, or, with a model, the joint of that number, or one beside it for its rotor."""
    kind = "fixed" if model is None else "revolute" if limited else "continuous"
    element = Xml.SubElement(robot, "joint", name=child, type=kind)
    Xml.SubElement(element, "parent", link=parent)
    Xml.SubElement(element, "child", link=child)
    _origin(element, pos, np.eye(3))
    if model is not None:
        Xml.SubElement(element, "axis", xyz=_text(model.jnt_axis[joint]))
        lower, upper = map(repr, model.jnt_range[joint].tolist())
        bounds = {"lower": lower, "upper": upper} if limited else {}
        Xml.SubElement(element, "limit", bounds | {"effort": repr(_UNBOUNDED), "velocity": repr(_UNBOUNDED)})


def _shape(
    link: Xml.Element, model: mujoco.MjModel, geom: int, pos: Float[np.ndarray, "3"], folder: pathlib.Path
) -> None:
    """What collides; a mesh, of which its convex hull does, gets a file in the folder."""
    size, mesh = model.geom_size[geom], f"mesh_{model.geom_dataid[geom]}.obj"
    kinds = {
        mujoco.mjtGeom.mjGEOM_SPHERE: ("sphere", {"radius": repr(float(size[0]))}),
        mujoco.mjtGeom.mjGEOM_CAPSULE: (
            "capsule",
            {"radius": repr(float(size[0])), "length": repr(float(2 * size[1]))},
        ),
        mujoco.mjtGeom.mjGEOM_CYLINDER: (
            "cylinder",
            {"radius": repr(float(size[0])), "length": repr(float(2 * size[1]))},
        ),
        mujoco.mjtGeom.mjGEOM_BOX: ("box", {"size": _text(2 * size)}),
        mujoco.mjtGeom.mjGEOM_MESH: ("mesh", {"filename": mesh}),
    }
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind not in kinds:
        raise BadInput(
            f"{model.geom(geom).name}: its shape {kind.name.removeprefix('mjGEOM_').lower()} has no counterpart in a "
            'URDF (sphere, capsule, cylinder, box, mesh); use evaluation.backend = "mujoco"'
        )
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        _write_mesh(model, int(model.geom_dataid[geom]), folder / mesh)
    collision = Xml.SubElement(link, "collision")
    _origin(collision, pos, quaternion_to_matrix(model.geom_quat[geom]))
    name, values = kinds[kind]
    Xml.SubElement(Xml.SubElement(collision, "geometry"), name, values)


def _write_mesh(model: mujoco.MjModel, mesh: int, path: pathlib.Path) -> None:
    first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    faces = 1 + model.mesh_face[face : face + model.mesh_facenum[mesh]]
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()] + [f"f {a} {b} {c}" for a, b, c in faces.tolist()]
    path.write_text("\n".join([*lines, ""]))


def _origin(element: Xml.Element, pos: Float[np.ndarray, "3"], rotation: Float[np.ndarray, "3 3"]) -> None:
    """A frame: R = Rz(yaw) Ry(pitch) Rx(roll); where the pitch is a right angle, the roll is 0."""
    level = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = np.arctan2(-rotation[2, 0], level)
    if level < 1e-9:
        roll, yaw = 0.0, np.arctan2(-rotation[0, 1], rotation[1, 1])
    else:
        roll, yaw = np.arctan2(rotation[2, 1], rotation[2, 2]), np.arctan2(rotation[1, 0], rotation[0, 0])
    Xml.SubElement(element, "origin", xyz=_text(pos), rpy=_text(np.array([roll, pitch, yaw])))


def _text(values: Float[np.ndarray, " n"]) -> str:
    return " ".join(map(repr, values.tolist()))
