"""One optimal path, which can be drawn."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from agile_jax import report
from agile_jax.experiment import Experiment, load_experiment
from agile_jax.expert import (
    ExpertSettings,
    ExpertSolution,
    check_start,
    check_target,
    lowest_underside,
    make_expert,
)
from agile_jax.scene import Scene, SceneSettings, make_scene, top_speed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Pose = Sequence[float] | np.ndarray  # [x, y, z, yaw] [m, rad]


class SolvedPath(ExpertSolution):
    """The expert's answer for one start, together with the scene and the settings that it was found with."""

    scene: Scene
    settings: ExpertSettings

    @classmethod
    def of(cls, solution: ExpertSolution, scene: Scene, settings: ExpertSettings) -> "SolvedPath":
        """The same solution, with its scene and settings."""
        path = cls(*solution)
        path.scene, path.settings = scene, settings
        return path

    @property
    def lowest_underside(self) -> float:
        """The lowest underside that a plan in this scene could lead under [m]."""
        return lowest_underside(self.scene, self.settings)

    @property
    def lowest_height(self) -> float:
        """The lowest height of the path's nodes [m]."""
        return float(self.trajectory.states[:, 2].min())

    @property
    def top_speed(self) -> float:
        """How fast the robot may be along an axis of the plane at the lowest height of the path [m/s]."""
        return min(max(self.settings.velocity[:2]), float(top_speed(self.scene, self.lowest_height)))

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the path and the scene from above; without `ax` on a new figure, `ax.figure`.

        Raises:
            ValueError: nothing was solved.
        """
        if self.status != "solved":
            raise ValueError(f"there is no path to draw: {self.cause}")
        return report.draw_plan(report.new_axes() if ax is None else ax, self.scene, {self.branch: self.trajectory})

    def save(self, file: pathlib.Path, title: str = "") -> None:
        """Draw the path from above, from the side and from the front into a PNG."""
        report.save_figure(report.plan_figure(self.scene, {self.branch: self.trajectory}, title), file)

    def __repr__(self) -> str:
        if self.status != "solved":
            return f"SolvedPath({self.status}: {self.cause})"
        return f"SolvedPath({self.branch}, {self.duration:.4g} s, gap {100 * self.gap:.2g} %)"


def solve(
    problem: Experiment | SceneSettings | Scene | pathlib.Path | str,
    start: Pose,
    target: Pose | None = None,
    settings: ExpertSettings | None = None,
) -> SolvedPath:
    """Solve the paper's problem, from rest to rest, from one pose.

    `expert.initial_velocity` says how the labels of a dataset begin, and is not asked here.

    Args:
        problem: an experiment or its file; or a scene.
        start: pose [x, y, z, yaw] [m, rad].
        target: pose; the scene's when None.
        settings: of the expert; the experiment's when None, for a scene the defaults.

    Returns:
        The path; its `status` is "failed", and `cause` says why, where there is none.

    Raises:
        BadInput: the start or the target is outside the bounds or too near to an obstacle.
    """
    if isinstance(problem, str | pathlib.Path):
        problem = load_experiment(problem)
    if isinstance(problem, Experiment):
        settings = settings or problem.expert
        problem = problem.scene
    scene = make_scene(problem) if isinstance(problem, SceneSettings) else problem
    settings, pose = settings or ExpertSettings(), np.array(start, float)
    if target is not None:
        scene = scene._replace(target=np.array(target, float))
    check_start(scene, settings, pose)
    check_target(scene, settings)
    return SolvedPath.of(make_expert(scene, settings).solve(pose, initial_velocity="rest"), scene, settings)
