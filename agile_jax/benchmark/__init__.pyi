"""Names that the package offers; `__init__.py` loads each when it is first used."""

from . import (
    evaluation as evaluation,
    expert as expert,
    mpc as mpc,
    policy as policy,
    tracking as tracking,
    training as training,
)
from .metrics import Metric as Metric
from .subjects import SUBJECTS as SUBJECTS
