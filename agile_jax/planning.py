"""One expert solve from a given start, and its picture."""

import pathlib

import numpy as np

from agile_jax.experiment import Experiment
from agile_jax.expert import ExpertSolution, check_start, check_target, make_expert
from agile_jax.scene import make_scene


def plan(
    experiment: Experiment,
    start: tuple[float, ...],
    output: pathlib.Path | None = None,
    target: tuple[float, ...] | None = None,
) -> ExpertSolution:
    """Solve the paper's problem, from rest to rest, from one pose of the experiment's scene.

    `expert.initial_velocity` says how the labels begin, and is not asked here.

    Args:
        experiment: its scene and expert are used.
        start: pose [x, y, z, yaw] [m, rad].
        output: of the drawing, a PNG; None draws nothing.
        target: pose; the scene's when None.

    Raises:
        BadInput: the start or the target is outside the bounds or too near to an obstacle.
        OSError: the drawing cannot be written.
    """
    scene, pose = make_scene(experiment.scene), np.array(start, float)
    if target is not None:
        scene = scene._replace(target=np.array(target, float))
    check_start(scene, experiment.expert, pose)
    check_target(scene, experiment.expert)
    solution = make_expert(scene, experiment.expert).solve(pose, initial_velocity="rest")
    if output is not None and solution.status == "solved":
        from agile_jax.report import draw_plan

        output.parent.mkdir(parents=True, exist_ok=True)
        draw_plan(scene, {solution.branch: solution.trajectory}, output, experiment.name)
    return solution
