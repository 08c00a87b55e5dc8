"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .body import Reference as Reference
from .controller import (
    ControllerState as ControllerState,
    MpcController as MpcController,
    make_controller as make_controller,
    make_mpc_controller as make_mpc_controller,
)
from .diagnostics import Counts as Counts, Diagnostics as Diagnostics, no_diagnostics as no_diagnostics
from .estimator.estimator import Belief as Belief, Estimator as Estimator
from .estimator.measured import Measured as Measured
from .interface import Controller as Controller
from .settings import ControlSettings as ControlSettings, GaitSettings as GaitSettings, MpcSettings as MpcSettings
