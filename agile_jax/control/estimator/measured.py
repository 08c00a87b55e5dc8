"""What the sensors of one robot tell."""

from typing import NamedTuple

from jaxtyping import Bool, Float

from agile_jax.arrays import AnyArray


class Measured(NamedTuple):
    """One sample of all sensors."""

    angular_velocity: Float[AnyArray, "*batch 3"]  # of the trunk, along its axes [rad/s]
    specific_force: Float[AnyArray, "*batch 3"]  # acceleration of its origin less gravity's, along its axes [m/s^2]
    joint_pos: Float[AnyArray, "*batch 12"]  # [rad]
    joint_vel: Float[AnyArray, "*batch 12"]  # [rad/s]
    foot_contact: Bool[AnyArray, "*batch 4"]  # what each foot feels
    located: Bool[AnyArray, "*batch"]  # whether something else has told the pose
    planar_pose: Float[AnyArray, "*batch 3"]  # that pose: x, y [m], yaw [rad]
