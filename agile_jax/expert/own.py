"""An expert of a plugin: its paths are verified and described like those of the package's own expert."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from agile_jax.expert.search.branches import branch_name
from agile_jax.expert.search.minimum_time import lower_bound
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import ExpertSolution, Trajectory, failed_solution
from agile_jax.expert.verify import rejection, verify
from agile_jax.scene import POSE_SIZE, Scene, facing

SHORTEST = 0.1  # [s] the least duration by which the gap is made relative

# (scene, start, initial velocity: "rest" or "free") -> a path to the scene's target, None where there is none.
FindPath = Callable[[Scene, np.ndarray, str], Trajectory | None]


@dataclass(frozen=True)
class OwnExpert:
    """Labels along the paths that a plugin finds.

    Attributes:
        scene: obstacles, bounds and target.
        settings: bounds and margin, by which every path is judged.
        find_path: of the plugin.
    """

    scene: Scene
    settings: ExpertSettings
    find_path: FindPath

    def solve(
        self,
        start: Float[np.ndarray, "4"],
        initial_velocity: str | None = None,
        first: str = "",
        guess: int = 0,
        target: Float[np.ndarray, "4"] | None = None,
    ) -> ExpertSolution:
        """The verified path from a start pose; "failed", with the cause, where there is none or it breaks a bound.

        `first` and `guess` say how the package's own expert begins, and are not used.
        """
        del first, guess
        began = time.perf_counter()
        settings, condition = self.settings, initial_velocity or self.settings.initial_velocity
        start = np.array(start, float)
        scene = self.scene if target is None else self.scene._replace(target=np.array(target, float))
        scene = facing(scene, start)
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
        if cause := rejection(residuals):
            return failed_solution(settings, bound, f"the path of {settings.kind!r} is rejected: {cause}")
        duration, branch = float(path.times[-1]), branch_name(scene, path.states[:, :POSE_SIZE])
        objective = duration + settings.effort_weight * effort(path, np.array(settings.acceleration))
        return ExpertSolution(
            trajectory=path,
            duration=duration,
            lower_bound=bound,
            gap=(duration - bound) / max(bound, SHORTEST),
            branch=branch,
            objective=objective,
            status="solved",
            cause="",
            **residuals._asdict(),
            method=settings.kind,
            routes=((branch, objective),),
            solve_time_s=time.perf_counter() - began,
        )


def effort(path: Trajectory, acceleration: Float[np.ndarray, "4"]) -> float:
    """The integral of sum (u_i / a_i)^2 over a path [s], with accelerations constant over or linear in each interval.

    Args:
        path: its controls count.
        acceleration: bounds a [m/s^2, rad/s^2].
    """
    steps, u = np.diff(path.times), path.controls / acceleration
    here, there = (u, u) if len(u) == len(steps) else (u[:-1], u[1:])
    return float(steps @ (here**2 + here * there + there**2).sum(-1) / 3)
