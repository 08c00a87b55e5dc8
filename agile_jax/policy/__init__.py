"""The policy: a velocity field s -> s', what a robot needs of it at run time.

Only the settings are imported with the package; the rest loads JAX when first used.
"""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names
from agile_jax.policy.settings import PolicySettings

if TYPE_CHECKING:
    from agile_jax.policy.braking import braking_law
    from agile_jax.policy.export import Exported, export_policy
    from agile_jax.policy.feedback import FeedbackLaw
    from agile_jax.policy.field import Field, PlainField, ResidualField
    from agile_jax.policy.kinds import make_policy
    from agile_jax.policy.network import Normalization, PolicyParameters, parameter_count
    from agile_jax.policy.policy import Encoding, Policy, TrainedPolicy

__all__ = [
    "Encoding",
    "Exported",
    "FeedbackLaw",
    "Field",
    "Normalization",
    "PlainField",
    "Policy",
    "PolicyParameters",
    "PolicySettings",
    "ResidualField",
    "TrainedPolicy",
    "braking_law",
    "export_policy",
    "make_policy",
    "parameter_count",
]

__getattr__ = lazy_names(
    __name__,
    {
        "braking": "braking_law",
        "export": "Exported export_policy",
        "feedback": "FeedbackLaw",
        "field": "Field PlainField ResidualField",
        "kinds": "make_policy",
        "network": "Normalization PolicyParameters parameter_count",
        "policy": "Encoding Policy TrainedPolicy",
    },
)
