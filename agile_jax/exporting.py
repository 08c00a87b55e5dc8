"""The policy of a finished run, in files for use elsewhere."""

import pathlib

import numpy as np

from agile_jax.experiment import load_experiment
from agile_jax.run_directory import stage_state
from agile_jax.scene import make_scene
from agile_jax.settings import BadInput


def export(run_dir: pathlib.Path, output: pathlib.Path | None = None) -> list[pathlib.Path]:
    """Write the trained policy of a run directory (policy/export.py).

    Args:
        run_dir: with a finished training.
        output: the folder; `export` in the run directory when not given.

    Returns:
        The files.

    Raises:
        BadInput: no finished training there.
    """
    if not run_dir.is_dir():
        raise BadInput(f"{run_dir}: no such run directory; `agile run EXPERIMENT.toml` makes one")
    experiment = load_experiment(run_dir / "experiment.toml")
    if stage_state(run_dir, experiment, "training") != "done":
        raise BadInput(f"{run_dir}: its training is not finished; `agile train {run_dir / 'experiment.toml'}` first")
    from agile_jax.policy import export_policy, make_policy
    from agile_jax.training import load_parameters

    scene = make_scene(experiment.scene)
    limits = np.array(experiment.expert.velocity), np.array(experiment.expert.acceleration)
    policy = make_policy(scene, *limits, experiment.policy)
    parameters = load_parameters(run_dir / "training", policy)
    return export_policy(policy, parameters, experiment.policy, scene, *limits, output or run_dir / "export")
