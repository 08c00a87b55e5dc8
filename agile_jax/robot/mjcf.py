"""A quadruped with three joints a leg, rebuilt from its compiled MJCF in the names and the order of this package.

The result has 13 links (bodies fixed to a link become part of it), joints FR_abad, FR_hip, FR_knee, ... that turn about
+x, +y, +y, torque motors, and collision bits as robot/a1.xml has them. Everything else of the file (sensors, keyframes,
textures, scene) is left behind.

    trunk --x--> abad --y--> hip --y--> knee --> foot (a sphere)

Link frames have their origin on the joint's axis and, at zero angles, the trunk's directions; the trunk's origin is
midway between the abad axes.
"""

import pathlib
from typing import NamedTuple

import mujoco
import numpy as np

from agile_jax.robot.constants import JOINT_NAMES, LEG_NAMES
from agile_jax.robot.mjcf_legs import Leg, check_straight, joint_places, leg_joints, read_leg, torque_limit, trunk_body
from agile_jax.robot.settings import OWN, RobotSettings
from agile_jax.settings import BadInput

UNLIMITED = np.pi  # stands for a joint without limits [rad]
_GEOMS = {  # that can be copied
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_BOX,
    mujoco.mjtGeom.mjGEOM_MESH,
}
# conaffinity, as in a1.xml: shins do not collide with the floor, and of hips no distance to other links counts.
_TRUNK, _LEG = 7, (3, 7, 6)


def robot_spec(settings: RobotSettings) -> mujoco.MjSpec:
    """The robot alone, without a scene.

    Raises:
        BadInput: the file cannot be read, or is no such quadruped; with the reason.
    """
    if settings.name == OWN:
        return mujoco.MjSpec.from_file(str(pathlib.Path(__file__).with_name(f"{OWN}.xml")))
    path = pathlib.Path(settings.name)
    if not path.is_file():
        raise BadInput(f"robot.name = {settings.name!r}: neither {OWN!r} nor an MJCF file")
    try:
        source = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise BadInput(f"robot.name = {settings.name!r}: MuJoCo refuses it: {' '.join(str(error).split())}") from None
    try:
        return _rebuild(source, settings)
    except BadInput as error:
        raise BadInput(f"robot.name = {settings.name!r}: {error}") from None


class _Original(NamedTuple):
    """The robot as its file has it, at zero angles."""

    model: mujoco.MjModel
    data: mujoco.MjData
    owner: list[int]  # the link that each body is, or is fixed to; 0 for what stands in the world

    def members(self, link: int) -> list[int]:
        """The bodies that become one link."""
        return [body for body, owner in enumerate(self.owner) if owner == link]


def _rebuild(source: mujoco.MjModel, settings: RobotSettings) -> mujoco.MjSpec:
    joints = [leg_joints(source, settings, leg) for leg in settings.legs]
    trunk = trunk_body(source, joints)
    data = mujoco.MjData(source)
    data.qpos[:] = 0.0
    data.qpos[source.jnt_qposadr[source.body_jntadr[trunk]] + 3] = 1.0
    mujoco.mj_forward(source, data)
    legs = [read_leg(source, data, name, own) for name, own in zip(settings.legs, joints, strict=True)]
    for name, leg in zip(settings.legs, legs, strict=True):
        check_straight(data, name, leg)
    links = [int(source.jnt_bodyid[joint]) for leg in legs for joint in leg.joints]
    original = _Original(source, data, _owners(source, [trunk, *links]))
    origin = np.mean([data.xanchor[leg.joints[0]] for leg in legs], 0)

    spec = _empty_spec()
    body = spec.worldbody.add_body(name="trunk", pos=[0.0, 0.0, 1.0])
    body.add_freejoint(name="base")
    _fill(spec, original, body, trunk, origin, _TRUNK)
    for name, leg in zip(LEG_NAMES, legs, strict=True):
        _add_leg(spec, original, body, origin, name, leg)
    return spec


def _empty_spec() -> mujoco.MjSpec:
    """The options of robot/a1.xml, and nothing else."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return spec


def _add_leg(
    spec: mujoco.MjSpec, original: _Original, trunk: mujoco.MjsBody, origin: np.ndarray, name: str, leg: Leg
) -> None:
    """Hip, thigh and calf with their joints, geoms and motors; `origin` is the trunk's."""
    source = original.model
    parent, before = trunk, origin
    for k, place in enumerate(joint_places(original.data, leg, original.data.geom_xpos[leg.foot])):
        joint = leg.joints[k]
        dof = source.jnt_dofadr[joint]
        link = parent.add_body(name=f"{name}_{('hip', 'thigh', 'calf')[k]}", pos=place - before)
        link.add_joint(
            name=f"{name}_{JOINT_NAMES[k]}",
            axis=[1, 0, 0] if k == 0 else [0, 1, 0],
            range=_joint_range(source, name, leg, k),
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            damping=source.dof_damping[dof],
            armature=source.dof_armature[dof],
            frictionloss=source.dof_frictionloss[dof],
        )
        _fill(spec, original, link, int(source.jnt_bodyid[joint]), place, _LEG[k], leg.foot, name)
        limit = torque_limit(source, joint)
        spec.add_actuator(
            name=f"{name}_{JOINT_NAMES[k]}",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=f"{name}_{JOINT_NAMES[k]}",
            ctrllimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            ctrlrange=[-limit, limit],
        )
        parent, before = link, place


def _joint_range(source: mujoco.MjModel, name: str, leg: Leg, k: int) -> list[float]:
    """The range of a leg's k-th joint about +x or +y [rad]; a knee's ends at the straight leg."""
    joint = leg.joints[k]
    low, high = source.jnt_range[joint] if source.jnt_limited[joint] else (-UNLIMITED, UNLIMITED)
    if leg.signs[k] < 0:
        low, high = -high, -low
    if k == 2:
        high = min(high, 0.0)
        if low >= high:
            raise BadInput(f"leg {name}: its knee must bend backward, but its range is [{low:.3g}, {high:.3g}] rad")
    return [low, high]


def _owners(source: mujoco.MjModel, links: list[int]) -> list[int]:
    """The link that each body is, or is fixed to; 0 for what stands in the world."""
    owners = []
    for body in range(source.nbody):
        while body > 0 and body not in links:
            body = int(source.body_parentid[body])
        owners.append(body)
    return owners


def _fill(
    spec: mujoco.MjSpec,
    original: _Original,
    body: mujoco.MjsBody,
    link: int,
    origin: np.ndarray,
    affinity: int,
    foot: int | None = None,
    leg: str = "",
) -> None:
    """Give `body` the mass and the geoms of a link of the original; `origin` is the body's, at zero angles."""
    source, data, members = original.model, original.data, original.members(link)
    masses = source.body_mass[members]
    mass = masses.sum()
    if mass <= 0:
        raise BadInput(f"{body.name} has no mass")
    center = masses @ data.xipos[members] / mass
    inertia = np.zeros((3, 3))
    for member in members:
        axes, arm = data.ximat[member].reshape(3, 3), data.xipos[member] - center
        inertia += axes @ np.diag(source.body_inertia[member]) @ axes.T
        inertia += source.body_mass[member] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    body.mass, body.ipos, body.explicitinertial = mass, center - origin, True
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    count = 0
    for i in range(source.ngeom):
        kind = mujoco.mjtGeom(int(source.geom_type[i]))
        if source.geom_bodyid[i] not in members or kind not in _GEOMS:
            continue
        collides = bool(source.geom_contype[i] or source.geom_conaffinity[i])
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, data.geom_xmat[i])
        material = source.geom_matid[i]
        geom = body.add_geom(
            type=kind,
            size=source.geom_size[i],
            pos=data.geom_xpos[i] - origin,
            quat=quat,
            rgba=source.mat_rgba[material] if material >= 0 else source.geom_rgba[i],
            contype=0,
            conaffinity=affinity if collides else 0,
            condim=1,
            group=3 if collides else 2,
            mass=0,
        )
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            geom.meshname = _mesh(spec, source, int(source.geom_dataid[i]))
        if collides:
            geom.name = f"{body.name}_{count}"
            count += 1
        if i == foot:
            geom.name, geom.condim, geom.conaffinity, geom.priority = f"{leg}_foot", 3, _TRUNK, 1
            geom.friction = source.geom_friction[i]


def _mesh(spec: mujoco.MjSpec, source: mujoco.MjModel, index: int) -> str:
    """The mesh in the new model, added when it is first used."""
    name = f"mesh_{index}"
    if not any(mesh.name == name for mesh in spec.meshes):
        first, count = source.mesh_vertadr[index], source.mesh_vertnum[index]
        face, faces = source.mesh_faceadr[index], source.mesh_facenum[index]
        spec.add_mesh(
            name=name,
            uservert=source.mesh_vert[first : first + count].ravel(),
            userface=source.mesh_face[face : face + faces].ravel(),
        )
    return name
