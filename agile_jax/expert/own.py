"""An expert of a plugin: its paths are verified and described like those of the package's own expert."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agile_jax.expert.expert import Expert
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.retries import AttemptName
from agile_jax.expert.search.branches import branch_name
from agile_jax.expert.search.minimum_time import lower_bound
from agile_jax.expert.settings import InitialVelocity
from agile_jax.expert.solution import ExpertSolution, Trajectory, failed_solution, solved
from agile_jax.expert.verify import rejection, verify
from agile_jax.scene import POSE_SIZE, Scene

# (scene, start, initial velocity) -> a path to the scene's target, None where there is none.
FindPath = Callable[[Scene, np.ndarray, InitialVelocity], Trajectory | None]


@dataclass(frozen=True, eq=False)
class OwnExpert(Expert):
    """Labels along the paths that a plugin finds; the settings' bounds and margin judge every path.

    Attributes:
        find_path: of the plugin.
    """

    find_path: FindPath

    def _solve(self, problem: Problem, first_attempt: AttemptName, guess: int) -> ExpertSolution:
        del first_attempt, guess  # they say how the package's own expert begins
        scene, start, condition, settings = problem
        bound = lower_bound(start, scene.target, settings, condition)
        path = self.find_path(scene, start, condition)
        if path is None:
            return failed_solution(settings, bound, f"the expert {settings.kind!r} found no path")
        expected = failed_solution(settings, bound, "").trajectory
        shapes = [np.shape(array) for array in path]
        if shapes != [array.shape for array in expected]:
            names = ", ".join(f"{name} {array.shape}" for name, array in expected._asdict().items())
            return failed_solution(settings, bound, f"the path of {settings.kind!r} has shapes {shapes}, not {names}")
        residuals = verify(scene, settings, path, start, condition)
        if rejected := rejection(residuals):
            cause = f"the path of {settings.kind!r} is rejected: {rejected.text}"
            return failed_solution(settings, bound, cause)
        branch = branch_name(scene, path.states[:, :POSE_SIZE])
        objective = float(path.times[-1]) + settings.effort_weight * effort(path, settings.limits.acceleration)
        return solved(path, residuals, bound, branch, objective, settings.kind, ((branch, objective),))


def effort(path: Trajectory, acceleration: Float[np.ndarray, "4"]) -> float:
    """The integral of sum (u_i / a_i)^2 over a path [s], with accelerations constant over or linear in each interval.

    Args:
        path: its controls count.
        acceleration: bounds a [m/s^2, rad/s^2].
    """
    steps, u = np.diff(path.times), path.controls / acceleration
    here, there = (u, u) if len(u) == len(steps) else (u[:-1], u[1:])
    return float(steps @ (here**2 + here * there + there**2).sum(-1) / 3)
