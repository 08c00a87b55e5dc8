"""One robot in its scene in a PyBullet client of its own."""

import contextlib
import ctypes
import os
import pathlib
import tempfile
import weakref
from collections.abc import Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot import LEG_NAMES
from agile_jax.robot.mujoco_model import FLOOR_BIT
from agile_jax.settings import BadInput
from agile_jax.simulation.physics.urdf import FOOT, GEAR, ROTOR, write_rotors, write_urdf

SOLVER_ITERATIONS = 50  # Bullet's default; with 300 walks are the same to all digits that are shown of them
NEVER = 1e6  # a force or a speed that is not reached [N, Nm, rad/s]
TRUNK = -1  # Bullet's number of a body's first link


class Touched(NamedTuple):
    """What the robot touched in any of some steps, as in `Sensed`."""

    obstacle: bool
    floor: bool
    feet: Bool[np.ndarray, "4"]


def check_bullet(model: mujoco.MjModel) -> None:
    """Refuse (BadInput) where PyBullet is not installed, or the robot cannot be written as a URDF."""
    if find_spec("pybullet") is None:
        raise BadInput('evaluation.backend = "pybullet" needs PyBullet: pip install "agile_jax[pybullet]"')
    with tempfile.TemporaryDirectory() as folder:
        write_urdf(model, pathlib.Path(folder))


class World:
    """A client of PyBullet with one robot in its scene."""

    def __init__(self, rotor_reaction: bool = True) -> None:
        """Args: rotor_reaction: whether rotors react on the links that carry them."""
        self._bullet, self._rotor_reaction = _Client(), rotor_reaction

    def start(self, model: mujoco.MjModel, qpos: Float[np.ndarray, "19"]) -> None:
        """Make the world anew, so that nothing of what was before is left: a robot at rest at coordinates `qpos`.

        Args:
            model: from `robot.build_mujoco_model`, of the robot and its scene.
            qpos: of MuJoCo.

        Raises:
            BadInput: the robot cannot be written as a URDF.
        """
        bullet = self._bullet
        bullet.resetSimulation()
        bullet.setGravity(*model.opt.gravity)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=model.opt.timestep,
            numSolverIterations=SOLVER_ITERATIONS,
            solverResidualThreshold=0.0,
            enableConeFriction=1,
            deterministicOverlappingPairs=1,
        )
        self._floor = [self._stand(model, geom) for geom in np.flatnonzero(model.geom_contype & FLOOR_BIT).tolist()]
        for geom in np.flatnonzero(model.geom_contype & ~FLOOR_BIT).tolist():
            self._stand(model, geom)
        with tempfile.TemporaryDirectory() as folder:  # another each time: Bullet remembers meshes by their path
            robot, flags = pathlib.Path(folder), bullet.URDF_USE_INERTIA_FROM_FILE
            self._robot = bullet.loadURDF(str(write_urdf(model, robot, self._rotor_reaction)), flags=flags)
            self._rotors = self._robot
            if not self._rotor_reaction:
                self._rotors = bullet.loadURDF(str(write_rotors(model, robot)), useFixedBase=1, flags=flags)
        self._links = self._links_of(self._robot)
        self._joints = [self._links[model.body(int(body)).name] for body in model.jnt_bodyid[1:]]
        self._feet = [self._links[leg + FOOT] for leg in LEG_NAMES]
        self._limit = model.actuator_ctrlrange[:, 1].copy()
        self._set_contacts(model)
        self._set_joints(model)
        self._place(qpos)

    def step(self, torques: Float[np.ndarray, "12"], push: Float[np.ndarray, "3"] | None, steps: int) -> Touched:
        """Advance by time steps of the model.

        Args:
            torques: of the joints, held; clamped to the limits [Nm].
            push: force on the trunk's centre of mass in the world [N].
            steps: how many.
        """
        bullet, touching = self._bullet, set()
        torques = np.clip(torques, -self._limit, self._limit).tolist()
        for _ in range(steps):
            bullet.setJointMotorControlArray(self._robot, self._joints, bullet.TORQUE_CONTROL, forces=torques)
            if push is not None:
                center = bullet.getBasePositionAndOrientation(self._robot)[0]
                bullet.applyExternalForce(self._robot, TRUNK, push.tolist(), center, bullet.WORLD_FRAME)
            bullet.stepSimulation()
            # Of the other body, and of the robot's link: those that overlap or push, not those that are near.
            touching |= {(at[2], at[3]) for at in bullet.getContactPoints(self._robot) if at[8] < 0 or at[9] > 0}
        links = {link for _, link in touching}
        return Touched(
            obstacle=any(body not in self._floor for body, _ in touching),
            floor=any(body in self._floor and link not in self._feet for body, link in touching),
            feet=np.array([foot in links for foot in self._feet]),
        )

    def state(self) -> tuple[Float[np.ndarray, "19"], Float[np.ndarray, "18"]]:
        """Coordinates and velocities as MuJoCo has them: Bullet tells of the trunk's centre of mass and main axes."""
        bullet = self._bullet
        center, axes = bullet.getBasePositionAndOrientation(self._robot)
        linear, angular = map(np.array, bullet.getBaseVelocity(self._robot))
        offset, turn = bullet.invertTransform(*self._inertial)
        pos, quat = bullet.multiplyTransforms(center, axes, offset, turn)
        quat = np.array(quat)[[3, 0, 1, 2]]
        joints = np.array([state[:2] for state in bullet.getJointStates(self._robot, self._joints)])
        linear = linear + np.cross(angular, np.array(pos) - center)
        angular = quaternion_to_matrix(quat).T @ angular
        return np.concatenate([pos, quat, joints[:, 0]]), np.concatenate([linear, angular, joints[:, 1]])

    def close(self) -> None:
        """End the client."""
        self._bullet.end()

    def _links_of(self, body: int) -> dict[str, int]:
        """Bullet's numbers of a body's links but the first, by their names."""
        infos = [self._bullet.getJointInfo(body, link) for link in range(self._bullet.getNumJoints(body))]
        return {info[12].decode(): link for link, info in enumerate(infos)}

    def _stand(self, model: mujoco.MjModel, geom: int) -> int:
        """Put a geom of the scene into the world; its number."""
        bullet = self._bullet
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            shape = bullet.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0.0, 0.0, 1.0])
        else:
            shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=model.geom_size[geom].tolist())
        quat = model.geom_quat[geom][[1, 2, 3, 0]].tolist()
        body: int = bullet.createMultiBody(0, shape, -1, model.geom_pos[geom].tolist(), quat)
        bullet.changeDynamics(body, TRUNK, lateralFriction=1.0)  # the product counts, so that a foot's rules
        return body

    def _set_contacts(self, model: mujoco.MjModel) -> None:
        """Friction of the feet, and of nothing else; what passes through the floor."""
        bullet = self._bullet
        for body in {self._robot, self._rotors}:
            for link in range(TRUNK, bullet.getNumJoints(body)):
                bullet.changeDynamics(
                    body, link, lateralFriction=0.0, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=NEVER
                )
        for leg, foot in zip(LEG_NAMES, self._feet, strict=True):
            bullet.changeDynamics(self._robot, foot, lateralFriction=model.geom(leg + FOOT).friction[0])
        for body in range(2, model.nbody):
            geoms = (model.geom_bodyid == body) & (model.geom_conaffinity > 0)
            geoms &= [not model.geom(geom).name.endswith(FOOT) for geom in range(model.ngeom)]
            if not np.any(model.geom_conaffinity[geoms] & FLOOR_BIT):
                for floor in self._floor:
                    bullet.setCollisionFilterPair(self._robot, floor, self._links[model.body(body).name], TRUNK, 0)

    def _set_joints(self, model: mujoco.MjModel) -> None:
        """Damping and dry friction of the joints; their rotors, geared to them."""
        bullet, rotors = self._bullet, self._links_of(self._rotors)
        for joint, link in enumerate(self._joints, start=1):
            dof = model.jnt_dofadr[joint]
            bullet.changeDynamics(self._robot, link, jointDamping=model.dof_damping[dof])
            friction = float(model.dof_frictionloss[dof])
            bullet.setJointMotorControl2(self._robot, link, bullet.VELOCITY_CONTROL, targetVelocity=0.0, force=friction)
            rotor = rotors.get(model.joint(joint).name + ROTOR)
            if rotor is not None:
                bullet.setJointMotorControl2(self._rotors, rotor, bullet.VELOCITY_CONTROL, force=0.0)
                frame = [0.0, 0.0, 0.0]
                gear = bullet.createConstraint(
                    self._rotors, rotor, self._robot, link, bullet.JOINT_GEAR, [1.0, 0.0, 0.0], frame, frame
                )
                bullet.changeConstraint(gear, gearRatio=-GEAR, maxForce=NEVER, erp=0.0)

    def _place(self, qpos: Float[np.ndarray, "19"]) -> None:
        bullet = self._bullet
        self._inertial = bullet.getDynamicsInfo(self._robot, TRUNK)[3:5]
        pose = bullet.multiplyTransforms(qpos[:3].tolist(), qpos[[4, 5, 6, 3]].tolist(), *self._inertial)
        bullet.resetBasePositionAndOrientation(self._robot, *pose)
        for link, angle in zip(self._joints, qpos[7:].tolist(), strict=True):
            bullet.resetJointState(self._robot, link, angle, 0.0)


class _Client:
    """The functions and constants of PyBullet, the functions for one client of it."""

    def __init__(self) -> None:
        with _silent():  # PyBullet tells when it was built, and what it was called with
            self._module = import_module("pybullet")
            self._number = self._module.connect(self._module.DIRECT)
        self.end = weakref.finalize(self, self._module.disconnect, self._number)  # at the latest when none holds it

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        if callable(found):
            found = partial(found, physicsClientId=self._number)
        setattr(self, name, found)  # found once
        return found


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Nothing on the process's standard output and error, not from libraries in C either."""
    flush = ctypes.CDLL(None).fflush
    flush(None)
    kept, nowhere = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        yield
        flush(None)
    finally:
        for stream, before in zip((1, 2), kept, strict=True):
            os.dup2(before, stream)
            os.close(before)
        os.close(nowhere)
