"""The policy: a velocity field s -> s' learned from the expert's labels, and its training.

Only the settings are imported with the package; the rest loads JAX when first used.
"""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names
from agile_jax.policy.settings import ClosedLoopSettings, DaggerSettings, PolicySettings, TrainingSettings

if TYPE_CHECKING:
    from agile_jax.policy.braking import braking_law
    from agile_jax.policy.checkpoint import load_parameters
    from agile_jax.policy.closed_loop import OUTCOMES, Followed, Follower, follow, make_follower
    from agile_jax.policy.export import export_policy
    from agile_jax.policy.field import Encoding, Policy
    from agile_jax.policy.kinds import make_policy
    from agile_jax.policy.network import Normalization, PolicyParameters, parameter_count
    from agile_jax.policy.noise_floor import GammaTest, gamma_test
    from agile_jax.policy.query import make_velocities
    from agile_jax.policy.stage import train
    from agile_jax.policy.training import Fitted, fit_policy

__getattr__ = lazy_names(
    __name__,
    {
        "braking": "braking_law",
        "checkpoint": "load_parameters",
        "closed_loop": "OUTCOMES Followed Follower follow make_follower",
        "export": "export_policy",
        "field": "Encoding Policy",
        "noise_floor": "GammaTest gamma_test",
        "kinds": "make_policy",
        "network": "Normalization PolicyParameters parameter_count",
        "query": "make_velocities",
        "stage": "train",
        "training": "Fitted fit_policy",
    },
)

__all__ = [
    "OUTCOMES",
    "ClosedLoopSettings",
    "DaggerSettings",
    "Encoding",
    "Fitted",
    "Followed",
    "Follower",
    "GammaTest",
    "Normalization",
    "Policy",
    "PolicyParameters",
    "PolicySettings",
    "TrainingSettings",
    "braking_law",
    "export_policy",
    "fit_policy",
    "follow",
    "gamma_test",
    "load_parameters",
    "make_follower",
    "make_policy",
    "make_velocities",
    "parameter_count",
    "train",
]
