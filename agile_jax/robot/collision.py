"""The robot's collision geometry as round segments and boxes: its exact clearance to the scene's obstacles, and how
near its legs come to its trunk and to each other.

A sphere is a segment without length and a capsule a segment, both with a radius. Two boxes that do not overlap are
nearest on an edge of one of them, so that every distance is one of a segment to a box (geometry.py). Shapes of other
kinds are covered by their bounding box.

The robot passes through itself in the physics, so that the distance to itself is only measured: of thighs, calves and
feet to the trunk, and of those of different legs to each other. Hips do not count, which turn about an axis in the
trunk, nor the links of one leg, whose joints have limits. A box of a leg is covered by a capsule there.
"""

from typing import NamedTuple

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from agile_jax.arrays import AnyArray
from agile_jax.geometry import quaternion_to_matrix, rotation_2d, segment_box_distance, segment_distance
from agile_jax.robot.constants import BOX_CORNERS
from agile_jax.robot.kinematics import link_poses
from agile_jax.robot.model import QPOS_SIZE, RobotModel
from agile_jax.robot.mujoco_model import OBSTACLE_BIT
from agile_jax.scene import Scene

_PAIRS = [(i, j) for i in range(8) for j in range(i)]
ITSELF_BIT = 4  # of a geom's conaffinity: it counts in the distance of the robot to itself
EDGES = np.array([p for p in _PAIRS if np.abs(BOX_CORNERS[p[0]] - BOX_CORNERS[p[1]]).sum() == 2])  # (12, 2) corners


class OwnShapes(NamedTuple):
    """What of the robot could touch the robot. Links in the order of `link_poses`."""

    segment_links: Int[np.ndarray, " n"]
    segments: Float[np.ndarray, "n 2 3"]  # ends in the link's frame [m]
    radii: Float[np.ndarray, " n"]  # [m]
    pairs: Int[np.ndarray, "p 2"]  # of segments whose distance counts
    box_pairs: Int[np.ndarray, "q 2"]  # a segment, a box of the trunk
    box_centers: Float[np.ndarray, "m 3"]  # [m]
    box_rotations: Float[np.ndarray, "m 3 3"]  # trunk from box
    box_halves: Float[np.ndarray, "m 3"]  # [m]


class CollisionShapes(NamedTuple):
    """What of the robot can touch an obstacle. Links in the order of `link_poses`."""

    segment_links: Int[np.ndarray, " n"]
    segments: Float[np.ndarray, "n 2 3"]  # ends in the link's frame [m]; the edges of boxes among them
    radii: Float[np.ndarray, " n"]  # [m]
    box_links: Int[np.ndarray, " m"]
    box_centers: Float[np.ndarray, "m 3"]  # in the link's frame [m]
    box_rotations: Float[np.ndarray, "m 3 3"]  # link from box
    box_halves: Float[np.ndarray, "m 3"]  # [m]
    own: OwnShapes  # what could touch the robot itself


def collision_shapes(model: mujoco.MjModel) -> CollisionShapes:
    """The shapes of a model made by `build_mujoco_model`."""
    segments, boxes = [], []
    for index in range(model.ngeom):
        geom = model.geom(index)
        link = int(geom.bodyid[0]) - 1
        if link < 0 or not geom.conaffinity[0] & OBSTACLE_BIT:
            continue
        if (round_one := _round(model, index)) is not None:
            segments.append((link, *round_one))
            continue
        center, rotation, half = _box(model, index)
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
        _own_shapes(model),
    )


def _round(model: mujoco.MjModel, index: int) -> tuple[np.ndarray, float] | None:
    """A sphere or capsule as the ends of its segment in the link's frame and its radius [m]; None for other shapes."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[index])), model.geom_size[index]
    if kind not in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
        return None
    reach = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
    axis = quaternion_to_matrix(model.geom_quat[index])[:, 2]
    return model.geom_pos[index] + np.outer([-reach, reach], axis), float(size[0])


def _box(model: mujoco.MjModel, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The bounding box of another shape: centre in the link's frame, link from box, half sizes [m]."""
    rotation, box = quaternion_to_matrix(model.geom_quat[index]), model.geom_aabb[index]
    return model.geom_pos[index] + rotation @ box[:3], rotation, box[3:]


def _own_shapes(model: mujoco.MjModel) -> OwnShapes:
    segments, boxes = [], []
    for index in np.flatnonzero(model.geom_conaffinity & ITSELF_BIT).tolist():
        link = int(model.geom_bodyid[index]) - 1
        if (round_one := _round(model, index)) is not None:
            segments.append((link, *round_one))
        elif link == 0:
            boxes.append(_box(model, index))
        else:
            center, rotation, half = _box(model, index)
            longest = int(half.argmax())
            ends = center + np.outer([-half[longest], half[longest]], rotation[:, longest])
            segments.append((link, ends, float(np.linalg.norm(np.delete(half, longest)))))
    links = np.array([link for link, _, _ in segments])
    legs = (links + 2) // 3  # 0 for the trunk, then 1 to 4
    first, second = np.triu_indices(len(links), 1)
    counts = legs[first] != legs[second]
    return OwnShapes(
        links,
        np.array([ends for _, ends, _ in segments]),
        np.array([radius for _, _, radius in segments]),
        np.column_stack([first[counts], second[counts]]),
        np.stack(np.meshgrid(np.flatnonzero(legs), np.arange(len(boxes))), -1).reshape(-1, 2),
        *(
            np.array([box[part] for box in boxes]).reshape(-1, *shape)
            for part, shape in enumerate([(3,), (3, 3), (3,)])
        ),
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


def own_clearance(robot: RobotModel, shapes: OwnShapes, qpos: Float[AnyArray, " nq"]) -> Float[Array, ""]:
    """Distance of the legs to the trunk and to each other, whichever is smaller [m]; negative where they overlap.

    Args:
        robot: constants.
        shapes: `collision_shapes(model).own`.
        qpos: coordinates, the robot's first.
    """
    links = link_poses(robot, qpos[7:QPOS_SIZE])
    pos, rotation = links.pos[shapes.segment_links], links.rotation[shapes.segment_links]
    ends = pos[:, None] + jnp.einsum("sij,skj->ski", rotation, jnp.asarray(shapes.segments, jnp.float32))
    first, second = shapes.pairs.T
    reach = shapes.radii[first] + shapes.radii[second]
    nearest = (segment_distance(ends[first], ends[second], jnp) - reach).min()
    if len(shapes.box_pairs):
        segment, box = shapes.box_pairs.T
        local = jnp.einsum("qji,qkj->qki", shapes.box_rotations[box], ends[segment] - shapes.box_centers[box, None])
        halves = jnp.asarray(shapes.box_halves[box], jnp.float32)
        distances = segment_box_distance(local[:, 0], local[:, 1], halves, jnp) - shapes.radii[segment]
        nearest = jnp.minimum(nearest, distances.min())
    return nearest
