"""The kinds of policies by name."""

import numpy as np

from agile_jax.policy.feedback import make_feedback
from agile_jax.policy.field import Policy, make_field
from agile_jax.policy.settings import PolicySettings
from agile_jax.scene import Scene


def make_policy(
    scene: Scene, velocity_limit: np.ndarray, acceleration_limit: np.ndarray, settings: PolicySettings
) -> Policy:
    """The policy that `settings` describe.

    Args:
        scene: target and obstacles.
        velocity_limit, acceleration_limit: bounds of the labels, shape (4,) [m/s, rad/s], [m/s^2, rad/s^2].
        settings: kind, network and features.
    """
    make = make_feedback if settings.kind == "feedback" else make_field
    return make(scene, velocity_limit, acceleration_limit, settings)
