"""Evaluation: success rates with honest intervals, failures by cause, arrival times against the expert's."""

from typing import TYPE_CHECKING

from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.lazy import lazy_names

if TYPE_CHECKING:
    from agile_jax.evaluation.single import rollout_one
    from agile_jax.evaluation.stage import evaluate
    from agile_jax.evaluation.statistics import wilson_interval

__all__ = ["EvaluationSettings", "evaluate", "rollout_one", "wilson_interval"]

__getattr__ = lazy_names(__name__, {"stage": "evaluate", "single": "rollout_one", "statistics": "wilson_interval"})
