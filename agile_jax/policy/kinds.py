"""The kinds of policies by name."""

import numpy as np

from agile_jax import plugins
from agile_jax.expert import MotionLimits
from agile_jax.policy.feedback import FeedbackLaw
from agile_jax.policy.field import PlainField, ResidualField
from agile_jax.policy.policy import Policy
from agile_jax.policy.settings import PolicySettings
from agile_jax.scene import Scene, without_way_over
from agile_jax.settings import BadInput

KINDS: dict[str, type[Policy]] = {"plain": PlainField, "residual": ResidualField, "feedback": FeedbackLaw}


def float32_scene(scene: Scene) -> Scene:
    """The scene with all lengths and angles in float32."""
    single = {name: np.asarray(array, np.float32) for name, array in scene._asdict().items() if array.dtype.kind == "f"}
    return scene._replace(**single)


def make_policy(scene: Scene, limits: MotionLimits, settings: PolicySettings) -> Policy:
    """The policy that the settings describe.

    Args:
        scene: target, obstacles and bounds of the pose.
        limits: of the labels' velocity and acceleration.
        settings: kind, network and features.

    Raises:
        BadInput: a plugin's policy is none.
    """
    scene, limits = (
        float32_scene(without_way_over(scene)),
        MotionLimits(*(np.asarray(array, np.float32) for array in limits)),
    )
    if settings.kind in KINDS:
        return KINDS[settings.kind](scene, limits, settings)
    made = plugins.find("policy", settings.kind)(scene, limits, settings)
    if not isinstance(made, Policy):
        raise BadInput(f"the plugin's policy {settings.kind!r} is {type(made).__name__}, not a Policy")
    return made
