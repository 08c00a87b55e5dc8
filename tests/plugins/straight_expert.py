"""A plugin of the tests: the time-optimal motion along a straight line, blind to obstacles."""

import numpy as np

from agile_jax.expert import ExpertSettings, Trajectory
from agile_jax.plugins import register
from agile_jax.settings import Fraction


class StraightSettings(ExpertSettings):
    """Bounds and margin are those of every expert."""

    share: Fraction = 1.0
    """Share of the acceleration's bounds that is used."""


@register("expert", "straight", StraightSettings)
def make_straight(scene, settings):
    """Speed up with the most that the slowest axis allows, then slow down, with half of the intervals each."""
    velocity, acceleration = np.array(settings.velocity), settings.share * np.array(settings.acceleration)

    def find_path(scene, start, initial_velocity):
        if initial_velocity != "rest":
            return None
        way = scene.target - start
        duration = max(2 * np.sqrt(np.abs(way) / acceleration).max(), 2 * (np.abs(way) / velocity).max())
        times = np.linspace(0.0, duration, settings.nodes + 1)
        controls = np.sign(settings.nodes / 2 - 0.5 - np.arange(settings.nodes))[:, None] * 4 * way / duration**2
        late = np.maximum(times - duration / 2, 0.0)[:, None]
        t = times[:, None]
        poses = start + 4 * way / duration**2 * (t**2 / 2 - late**2)
        rates = 4 * way / duration**2 * (t - 2 * late)
        return Trajectory(times, np.concatenate([poses, rates], 1), controls)

    return find_path
