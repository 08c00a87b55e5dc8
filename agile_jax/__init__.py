"""Learning agile paths from optimal control, from the optimal control problem to a robot that crawls under a table.

    scene -> expert -> dataset -> policy -> control -> simulation -> evaluation -> report

`agile_jax.scene` describes the world, `expert` solves the minimum-time problem, `dataset` stores its verified
solutions, `policy` learns the velocity field s -> s', `control` tracks it with torques, `simulation` runs the
physics, `evaluation` counts successes, `report` draws.

    import agile_jax as aj

    aj.solve("experiments/quickstart.toml", (0, 0, 0.28, 0))    # one optimal path
    run = aj.open_run("runs/quickstart")                        # a finished run: run.policy, run.rollout, ...

Importing this package imports nothing: each name is loaded when it is first used (docs/python.md).
"""

from typing import TYPE_CHECKING

from agile_jax.lazy import lazy_names

if TYPE_CHECKING:
    from agile_jax import (
        control,
        dataset,
        evaluation,
        experiment,
        expert,
        policy,
        report,
        robot,
        scene,
        simulation,
        training,
    )
    from agile_jax.api.episode import RecordedEpisode
    from agile_jax.api.learning import make_dataset, train
    from agile_jax.api.run import Episodes, Run, open_run, run
    from agile_jax.api.solving import SolvedPath, solve
    from agile_jax.experiment import Experiment, load_experiment
    from agile_jax.settings import BadInput

__all__ = [
    "BadInput",
    "Episodes",
    "Experiment",
    "RecordedEpisode",
    "Run",
    "SolvedPath",
    "control",
    "dataset",
    "evaluation",
    "experiment",
    "expert",
    "load_experiment",
    "make_dataset",
    "open_run",
    "policy",
    "report",
    "robot",
    "run",
    "scene",
    "simulation",
    "solve",
    "train",
    "training",
]

__getattr__ = lazy_names(
    __name__,
    {
        "api.episode": "RecordedEpisode",
        "experiment": "Experiment load_experiment",
        "api.learning": "make_dataset train",
        "api.run": "Episodes Run open_run run",
        "settings": "BadInput",
        "api.solving": "SolvedPath solve",
    },
    "control dataset evaluation experiment expert policy report robot scene simulation training",
)
