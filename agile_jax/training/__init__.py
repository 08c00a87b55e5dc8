"""The training: from the expert's labels to a policy, and the learner's own test of it.

Only the settings are imported with the package; the rest loads JAX when first used.
"""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names
from agile_jax.training.finished import read_finished
from agile_jax.training.settings import AggregationSettings, KinematicTestSettings, TrainingSettings

if TYPE_CHECKING:
    from agile_jax.training.checkpoint import load_policy
    from agile_jax.training.fit import FitProblem, Fitted, Keeping, fit_policy
    from agile_jax.training.kinematic_test.follow import OUTCOMES, Followed, Follower, follow, make_follower
    from agile_jax.training.noise_floor import GammaTest, gamma_test
    from agile_jax.training.samples import Samples
    from agile_jax.training.stage import fit_dataset, train, train_on

__all__ = [
    "OUTCOMES",
    "AggregationSettings",
    "FitProblem",
    "Fitted",
    "Followed",
    "Follower",
    "GammaTest",
    "Keeping",
    "KinematicTestSettings",
    "Samples",
    "TrainingSettings",
    "fit_dataset",
    "fit_policy",
    "follow",
    "gamma_test",
    "load_policy",
    "make_follower",
    "read_finished",
    "train",
    "train_on",
]

__getattr__ = lazy_names(
    __name__,
    {
        "checkpoint": "Keeping load_policy",
        "fit": "FitProblem Fitted fit_policy",
        "kinematic_test.follow": "OUTCOMES Followed Follower follow make_follower",
        "noise_floor": "GammaTest gamma_test",
        "samples": "Samples",
        "stage": "fit_dataset train train_on",
    },
)
