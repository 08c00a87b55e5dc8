"""What every expert is: a function of a start, whose answers are verified."""

import abc
import time
from dataclasses import dataclass

from agile_jax.expert.feasible_poses import check_target, checked_pose
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.retries import ATTEMPT_NAMES, AttemptName
from agile_jax.expert.settings import ExpertSettings, InitialVelocity, checked_initial_velocity
from agile_jax.expert.solution import ExpertSolution
from agile_jax.scene import PoseLike, Scene, facing, planar_scene, without_way_over
from agile_jax.settings import BadInput


@dataclass(frozen=True, eq=False)
class Expert(abc.ABC):
    """Paths of least time to a target. `make_expert` makes one.

    Attributes:
        scene: obstacles, bounds of the pose, and the target where `solve` is given none.
        settings: the optimal control problem, and how it is solved.

    Raises:
        BadInput: the target keeps less than the margin.
    """

    scene: Scene
    settings: ExpertSettings

    def __post_init__(self) -> None:
        flat = self.settings.dimensions == "2d"
        check_target(planar_scene(self.scene) if flat else self.scene, self.settings)

    def solve(
        self,
        start: PoseLike,
        initial_velocity: InitialVelocity | None = None,
        first_attempt: AttemptName = "fatrop",
        guess: int = 0,
        target: PoseLike | None = None,
    ) -> ExpertSolution:
        """The path of least time from a pose to rest at the target.

        It is a pure function of its arguments. Where there is no path, the solution says so (status "failed", with its
        cause); `check_start` and `check_target` tell beforehand which poses are not free. With `dimensions = "2d"` the
        start's height is replaced by the target's. Where the bounds of yaw span a full turn, the path turns the shorter
        way, and its last yaw may differ from the target's by full turns.

        Args:
            start: pose [x, y, z, yaw], four numbers [m, m, m, rad].
            initial_velocity: "rest", or "free" for the best velocity within the bounds; the settings' when not given.
            first_attempt: of programs/retries.py, to begin with. No label depends on it.
            guess: number of the initial guess. No label depends on it.
            target: pose [x, y, z, yaw] [m, m, m, rad]; the scene's when not given.

        Raises:
            BadInput: a pose is not four finite numbers, or a word is not one of the choices.
        """
        began = time.perf_counter()
        condition = checked_initial_velocity(initial_velocity or self.settings.initial_velocity)
        if first_attempt not in ATTEMPT_NAMES:
            raise BadInput(f"first_attempt = {first_attempt!r}: must be one of {', '.join(ATTEMPT_NAMES)}")
        pose, scene = checked_pose("start", start), without_way_over(self.scene)
        if target is not None:
            scene = scene._replace(target=checked_pose("target", target))
        if self.settings.dimensions == "2d":
            scene = planar_scene(scene)
            pose[2] = scene.target[2]
        problem = Problem(facing(scene, pose), pose, condition, self.settings)
        solution = self._solve(problem, first_attempt, guess)
        return solution._replace(solve_time_s=time.perf_counter() - began)

    @abc.abstractmethod
    def _solve(self, problem: Problem, first_attempt: AttemptName, guess: int) -> ExpertSolution:
        """`solve` of checked arguments."""
