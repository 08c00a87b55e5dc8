"""Evaluation: success rates with honest intervals, failures by cause, arrival times against the expert's."""

from typing import TYPE_CHECKING

from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.lazy import lazy_names

if TYPE_CHECKING:
    from agile_jax.evaluation.backend import check_devices
    from agile_jax.evaluation.comparison import compare
    from agile_jax.evaluation.single import rollout_one
    from agile_jax.evaluation.statistics import mcnemar_p_value, wilson_interval

__all__ = [
    "EvaluationSettings",
    "check_devices",
    "compare",
    "mcnemar_p_value",
    "rollout_one",
    "wilson_interval",
]

__getattr__ = lazy_names(
    __name__,
    {
        "backend": "check_devices",
        "comparison": "compare",
        "single": "rollout_one",
        "statistics": "mcnemar_p_value wilson_interval",
    },
)
