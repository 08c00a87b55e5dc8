"""Whether the torso envelope, which plans keep clear of obstacles, covers the robot that follows them."""

import mujoco
import numpy as np
from jaxtyping import Float

from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot.constants import BOX_CORNERS, LEG_NAMES
from agile_jax.robot.mjcf import robot_spec
from agile_jax.robot.settings import OWN, RobotSettings
from agile_jax.settings import BadInput


def torso_extent(model: mujoco.MjModel) -> Float[np.ndarray, "3"]:
    """Half sizes of the box about the trunk's origin that covers what collides of trunk and hips [m]."""
    places = {model.body("trunk").id: np.zeros(3)}
    places |= {model.body(f"{leg}_hip").id: model.body(f"{leg}_hip").pos for leg in LEG_NAMES}
    extent = np.zeros(3)
    for i in range(model.ngeom):
        body = int(model.geom_bodyid[i])
        if body in places and model.geom_conaffinity[i]:
            box = model.geom_aabb[i]
            corners = model.geom_pos[i] + (box[:3] + BOX_CORNERS * box[3:]) @ quaternion_to_matrix(model.geom_quat[i]).T
            extent = np.maximum(extent, np.abs(places[body] + corners).max(0))
    return extent


def check_envelope(torso_half_size: tuple[float, float, float], settings: RobotSettings) -> None:
    """Refuse a torso envelope that does not cover trunk and hips of another robot than the A1.

    Raises:
        BadInput: with what it should be, or the robot's MJCF cannot be used.
    """
    if settings.name == OWN:
        return
    extent = torso_extent(robot_spec(settings).compile())
    if (extent > np.array(torso_half_size) + 1e-9).any():
        needed = [float(np.ceil(1000 * size) / 1000) for size in extent]
        raise BadInput(
            f"scene.torso_half_size = {list(torso_half_size)} does not cover trunk and hips of robot.name = "
            f"{settings.name!r}; it must be at least {needed} m, and the planned heights must fit that robot"
        )
