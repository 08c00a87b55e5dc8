"""Sweeps: trials of one experiment, identified by the hash of what they are, resumable, sharing equal stages."""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names
from agile_jax.sweep.settings import SweepSettings

if TYPE_CHECKING:
    from agile_jax.sweep.run import list_trials, run_sweep
    from agile_jax.sweep.trials import Trial, table

__all__ = ["SweepSettings", "Trial", "list_trials", "run_sweep", "table"]

# experiment.py reads SweepSettings, and the modules below read experiment.py.
__getattr__ = lazy_names(__name__, {"run": "list_trials run_sweep", "trials": "Trial table"})
