"""The kinds of experts: the package's own, and those of plugins."""

from typing import cast

from agile_jax import plugins
from agile_jax.expert.expert import Expert
from agile_jax.expert.minimum_time_expert import MinimumTimeExpert
from agile_jax.expert.own import FindPath, OwnExpert
from agile_jax.expert.settings import EXPERTS, ExpertSettings
from agile_jax.scene import Scene


def make_expert(scene: Scene, settings: ExpertSettings) -> Expert:
    """The expert for a scene, of the settings' kind.

    Raises:
        BadInput: the target keeps less than the margin.
    """
    if settings.kind in EXPERTS:
        return MinimumTimeExpert(scene, settings)
    return OwnExpert(scene, settings, cast(FindPath, plugins.find("expert", settings.kind)(scene, settings)))
