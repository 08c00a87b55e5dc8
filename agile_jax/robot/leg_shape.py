"""What of trunk and legs can touch something, in the plane of a leg."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot.constants import BOX_CORNERS, LEG_NAMES


class LegShape(NamedTuple):
    """What of trunk and legs can touch an obstacle, in the plane of a leg, at zero angles: round points."""

    trunk_top: float  # over the base's origin [m]
    trunk_bottom: float  # below it [m]
    thigh: Float[np.ndarray, "n 3"]  # x, z from the hip [m], radius [m]
    calf: Float[np.ndarray, "m 3"]  # x, z from the knee [m], radius [m]


def leg_shape(model: mujoco.MjModel) -> LegShape:
    """The shapes of a model made by `mjcf.robot_spec`, all four legs in one plane."""
    trunk = np.concatenate(
        [_body_points(model, "trunk")]
        + [_body_points(model, f"{leg}_hip") + np.append(model.body(f"{leg}_hip").pos, 0.0) for leg in LEG_NAMES]
    )
    thighs, calves = (
        np.concatenate([_body_points(model, f"{leg}_{link}") for leg in LEG_NAMES]) for link in ("thigh", "calf")
    )
    return LegShape(
        float((trunk[:, 2] + trunk[:, 3]).max()),
        float((trunk[:, 3] - trunk[:, 2]).max()),
        *(np.unique(points[:, [0, 2, 3]].round(9), axis=0) for points in (thighs, calves)),
    )


def _body_points(model: mujoco.MjModel, body: str) -> np.ndarray:
    """Round points that hold what collides of a body: x, y, z, radius in its frame, shape (n, 4) [m]."""
    own = np.flatnonzero((model.geom_bodyid == model.body(body).id) & (model.geom_conaffinity > 0))
    return np.concatenate([np.empty((0, 4)), *(_round_points(model, int(geom)) for geom in own)])


def _round_points(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points with radii whose hull is a geom, or holds it: x, y, z, radius in the link's frame, shape (n, 4)."""
    rotation, size = quaternion_to_matrix(model.geom_quat[geom]), model.geom_size[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
        reach = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        ends = model.geom_pos[geom] + np.outer([-reach, reach], rotation[:, 2])
        return np.column_stack([ends, np.full(2, size[0])])
    box = model.geom_aabb[geom]
    corners = model.geom_pos[geom] + (box[:3] + BOX_CORNERS * box[3:]) @ rotation.T
    return np.column_stack([corners, np.zeros(8)])
