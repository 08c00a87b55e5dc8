"""Names that the package offers; `__init__.py` loads each when it is first used."""

from . import (
    control as control,
    dataset as dataset,
    evaluation as evaluation,
    experiment as experiment,
    expert as expert,
    policy as policy,
    report as report,
    robot as robot,
    scene as scene,
    simulation as simulation,
    study as study,
    sweep as sweep,
    training as training,
)
from .api.episode import RecordedEpisode as RecordedEpisode
from .api.learning import make_dataset as make_dataset, train as train
from .api.run import Episodes as Episodes, Run as Run, open_run as open_run, run as run
from .api.solving import SolvedPath as SolvedPath, solve as solve
from .experiment import Experiment as Experiment, load_experiment as load_experiment
from .settings import BadInput as BadInput
