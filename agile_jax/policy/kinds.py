"""The kinds of policies by name."""

import numpy as np

from agile_jax import plugins
from agile_jax.policy.feedback import make_feedback
from agile_jax.policy.field import Policy, make_field
from agile_jax.policy.settings import POLICIES, PolicySettings
from agile_jax.scene import Scene
from agile_jax.settings import BadInput


def make_policy(
    scene: Scene, velocity_limit: np.ndarray, acceleration_limit: np.ndarray, settings: PolicySettings
) -> Policy:
    """The policy that `settings` describe.

    Args:
        scene: target and obstacles.
        velocity_limit, acceleration_limit: bounds of the labels, shape (4,) [m/s, rad/s], [m/s^2, rad/s^2].
        settings: kind, network and features.
    """
    if settings.kind == "feedback":
        return make_feedback(scene, velocity_limit, acceleration_limit, settings)
    if settings.kind in POLICIES:
        return make_field(scene, velocity_limit, acceleration_limit, settings)
    made = plugins.find("policy", settings.kind)(scene, velocity_limit, acceleration_limit, settings)
    if not isinstance(made, Policy):
        raise BadInput(f"the plugin's policy {settings.kind!r} is {type(made).__name__}, not a Policy")
    return made
