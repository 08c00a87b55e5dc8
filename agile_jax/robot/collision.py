"""The robot's collision geometry as round segments and boxes, and its exact clearance to the scene's obstacles.

A sphere is a segment without length and a capsule a segment, both with a radius. Two boxes that do not overlap are
nearest on an edge of one of them, so that every distance is one of a segment to a box (geometry.py). Shapes of other
kinds are covered by their bounding box.
"""

from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from agile_jax.arrays import AnyArray
from agile_jax.geometry import quaternion_to_matrix, rotation_2d, segment_box_distance
from agile_jax.robot.constants import BOX_CORNERS
from agile_jax.robot.kinematics import link_poses
from agile_jax.robot.model import QPOS_SIZE, RobotModel
from agile_jax.robot.mujoco_model import OBSTACLE_BIT
from agile_jax.scene import Scene

_PAIRS = [(i, j) for i in range(8) for j in range(i)]
EDGES = np.array([p for p in _PAIRS if np.abs(BOX_CORNERS[p[0]] - BOX_CORNERS[p[1]]).sum() == 2])  # (12, 2) corners


class CollisionShapes(NamedTuple):
    """What of the robot can touch an obstacle. Links in the order of `link_poses`."""

    segment_links: Int[np.ndarray, " n"]
    segments: Float[np.ndarray, "n 2 3"]  # ends in the link's frame [m]; the edges of boxes among them
    radii: Float[np.ndarray, " n"]  # [m]
    box_links: Int[np.ndarray, " m"]
    box_centers: Float[np.ndarray, "m 3"]  # in the link's frame [m]
    box_rotations: Float[np.ndarray, "m 3 3"]  # link from box
    box_halves: Float[np.ndarray, "m 3"]  # [m]


def collision_shapes(model: mujoco.MjModel) -> CollisionShapes:
    """The shapes of a model made by `build_mujoco_model`."""
    segments, boxes = [], []
    for index in range(model.ngeom):
        geom = model.geom(index)
        link = int(geom.bodyid[0]) - 1
        if link < 0 or not geom.conaffinity[0] & OBSTACLE_BIT:
            continue
        rotation = quaternion_to_matrix(geom.quat)
        kind = mujoco.mjtGeom(int(geom.type[0]))
        if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
            reach = geom.size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
            segments.append((link, geom.pos + np.outer([-reach, reach], rotation[:, 2]), float(geom.size[0])))
            continue
        center, half = geom.pos + rotation @ model.geom_aabb[index, :3], model.geom_aabb[index, 3:]
        boxes.append((link, center, rotation, half))
        corners = center + (BOX_CORNERS * half) @ rotation.T
        segments += [(link, corners[edge], 0.0) for edge in EDGES]
    return CollisionShapes(
        np.array([link for link, _, _ in segments]),
        np.array([ends for _, ends, _ in segments]),
        np.array([radius for _, _, radius in segments]),
        np.array([link for link, *_ in boxes], int),
        np.array([center for _, center, _, _ in boxes]).reshape(-1, 3),
        np.array([rotation for _, _, rotation, _ in boxes]).reshape(-1, 3, 3),
        np.array([half for *_, half in boxes]).reshape(-1, 3),
    )


def body_clearance(
    robot: RobotModel, shapes: CollisionShapes, scene: Scene, qpos: Float[AnyArray, " nq"]
) -> Float[Array, ""]:
    """Distance of the nearest shape to the nearest obstacle [m]; infinity in an empty scene.

    Not positive: they touch. How deep is told up to a capsule's radius only.

    Args:
        robot: constants.
        shapes: of the robot.
        scene: n obstacles.
        qpos: coordinates, the robot's first.
    """
    if len(scene.obstacle_centers) == 0:
        return jnp.float32(jnp.inf)
    links = link_poses(robot, qpos[7:QPOS_SIZE])
    base = quaternion_to_matrix(qpos[3:7], jnp)
    pos, rotation = qpos[:3] + links.pos @ base.T, base @ links.rotation  # world from link
    ends = pos[shapes.segment_links, None] + jnp.einsum(
        "sij,skj->ski", rotation[shapes.segment_links], jnp.asarray(shapes.segments, jnp.float32)
    )
    # In the frames of the obstacles.
    turns = np.tile(np.eye(3), (len(scene.obstacle_yaws), 1, 1))
    turns[:, :2, :2] = rotation_2d(scene.obstacle_yaws)
    halves = jnp.asarray(scene.obstacle_half_sizes, jnp.float32)
    centers = jnp.asarray(scene.obstacle_centers, jnp.float32)
    local = jnp.einsum("oji,oskj->oski", turns, ends - centers[:, None, None])
    distances = segment_box_distance(local[:, :, 0], local[:, :, 1], halves[:, None], jnp) - shapes.radii
    nearest = distances.min()
    if len(shapes.box_links):
        corners = centers[:, None] + jnp.einsum("oij,ocj->oci", turns, BOX_CORNERS * halves[:, None])
        edges = corners[:, EDGES]  # (o, 12, 2, 3)
        box_rotation = rotation[shapes.box_links] @ shapes.box_rotations
        box_center = pos[shapes.box_links] + jnp.einsum("mij,mj->mi", rotation[shapes.box_links], shapes.box_centers)
        seen = jnp.einsum("mji,omekj->omeki", box_rotation, edges[:, None] - box_center[:, None, None])
        box_halves = jnp.asarray(shapes.box_halves, jnp.float32)[:, None]
        nearest = jnp.minimum(nearest, segment_box_distance(seen[..., 0, :], seen[..., 1, :], box_halves, jnp).min())
    return nearest
