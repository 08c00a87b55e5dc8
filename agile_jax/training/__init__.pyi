"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .checkpoint import load_policy as load_policy
from .finished import read_finished as read_finished
from .fit import FitProblem as FitProblem, Fitted as Fitted, Keeping as Keeping, fit_policy as fit_policy
from .kinematic_test.follow import (
    OUTCOMES as OUTCOMES,
    Followed as Followed,
    Follower as Follower,
    make_follower as make_follower,
)
from .noise_floor import GammaTest as GammaTest, gamma_test as gamma_test
from .samples import Samples as Samples
from .settings import (
    AggregationSettings as AggregationSettings,
    KinematicTestSettings as KinematicTestSettings,
    TrainingSettings as TrainingSettings,
)
from .stage import fit_dataset as fit_dataset, train as train, train_on as train_on
