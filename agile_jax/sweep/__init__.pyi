"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .run import list_trials as list_trials, run_sweep as run_sweep
from .settings import SweepSettings as SweepSettings
from .trials import Trial as Trial, table as table
