"""A run directory as an object: experiment, expert, policy, dataset, episodes, and new episodes of the robot."""

import dataclasses
import pathlib
from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from agile_jax import dataset, evaluation, pipeline, policy, training
from agile_jax.api.episode import RecordedEpisode, load_recording
from agile_jax.api.solving import Pose, SolvedPath, solve
from agile_jax.experiment import STAGES, Experiment, load_experiment
from agile_jax.expert import Expert, make_expert
from agile_jax.files import read_json
from agile_jax.progress import Progress, silent
from agile_jax.run_directory import stage_paths, stage_state
from agile_jax.scene import Scene, make_scene
from agile_jax.settings import BadInput
from agile_jax.store.npz import load_npz

if TYPE_CHECKING:
    import pandas  # type: ignore[import-untyped]

    from agile_jax.dataset import Dataset
    from agile_jax.policy import Exported, TrainedPolicy

COMMANDS = {"dataset": "expert", "training": "train", "evaluation": "evaluate", "report": "report"}  # that make a stage


class Episodes(dict[str, np.ndarray]):
    """The episodes of an evaluation: columns by name, one entry an episode (evaluation/<backend>.npz)."""

    def __repr__(self) -> str:
        return f"Episodes({len(self['outcome'])} of {', '.join(self)})"

    def to_pandas(self) -> "pandas.DataFrame":
        """A pandas table, one row an episode; a column of vectors becomes one for each of their numbers."""
        try:
            import pandas
        except ModuleNotFoundError:
            raise BadInput("to_pandas needs pandas, which is not installed here: pip install pandas") from None
        flat = {name: values for name, values in self.items() if values.ndim == 1}
        for name, values in self.items():
            if values.ndim == 2:
                flat |= {f"{name}_{i}": values[:, i] for i in range(values.shape[1])}
        return pandas.DataFrame(flat)


@dataclasses.dataclass(frozen=True, repr=False)
class Run:
    """What a run directory holds; each part is read when it is first asked for.

    Attributes:
        directory: the run directory.
        experiment: its settings.

    What is not finished yet raises BadInput, which names the command that makes it.
    """

    directory: pathlib.Path
    experiment: Experiment

    @cached_property
    def scene(self) -> Scene:
        """Obstacles, target, torso and bounds."""
        return make_scene(self.experiment.scene)

    @cached_property
    def expert(self) -> Expert:
        """The expert of the run's scene: `run.expert.solve(start)` solves as for the labels."""
        return make_expert(self.scene, self.experiment.expert)

    @cached_property
    def policy(self) -> "TrainedPolicy":
        """The trained policy: `run.policy(pose)` is its velocity at a pose, `run.policy.batch(poses)` at many."""
        self._need("training")
        experiment = self.experiment
        return training.load_policy(
            self.directory / "training", self.scene, experiment.expert.limits, experiment.policy
        )

    @cached_property
    def dataset(self) -> "Dataset":
        """The verified trajectories."""
        self._need("dataset")
        return dataset.load(self.directory / "dataset")

    @cached_property
    def episodes(self) -> Episodes:
        """The episodes of the evaluation."""
        self._need("evaluation")
        return Episodes(
            load_npz(stage_paths(self.directory, self.experiment, "evaluation").summary.with_suffix(".npz"))
        )

    def summary(self, stage: str) -> dict[str, object]:
        """The summary of a stage: "dataset", "training" or "evaluation"."""
        self._need(stage)
        return read_json(stage_paths(self.directory, self.experiment, stage).summary) or {}

    def solve(self, start: Pose, target: Pose | None = None) -> SolvedPath:
        """One optimal path from rest to rest, see `agile_jax.solve`."""
        return solve(self.experiment, start, target)

    def rollout(self, start: Pose, progress: Progress = silent) -> RecordedEpisode:
        """Let the robot run from a pose [x, y, z, yaw] [m, rad] with the trained policy, in C MuJoCo.

        Raises:
            BadInput: no finished training; or the start is outside the bounds or too near to an obstacle.
        """
        self._need("training")
        trace, summary = evaluation.rollout_one(self.experiment, self.directory, start, progress)
        return RecordedEpisode(self.experiment, trace, summary)

    def recording(self, file: pathlib.Path | str) -> RecordedEpisode:
        """A recorded episode of the evaluation, see `load_recording`."""
        return load_recording(self.experiment, pathlib.Path(file))

    def export(self, folder: pathlib.Path | str | None = None) -> "Exported":
        """Write the trained policy for use elsewhere (docs/export.md), into `export` of the run when None.

        Returns:
            The files, and why one is missing that others have.
        """
        return policy.export_policy(self.policy, pathlib.Path(folder or self.directory / "export"))

    def _need(self, stage: str) -> None:
        """Refuse (BadInput) a stage that is not finished."""
        if stage not in STAGES:
            raise BadInput(f"{stage}: no such stage; stages are {', '.join(STAGES)}")
        if stage_state(self.directory, self.experiment, stage) != "done":
            raise BadInput(
                f"{self.directory}: its {stage} is not finished; `agile {COMMANDS[stage]} {self.directory}` makes it"
            )

    def __repr__(self) -> str:
        done = [stage for stage in STAGES if stage_state(self.directory, self.experiment, stage) == "done"]
        return f"Run({self.directory}: {', '.join(done) or 'nothing'} done)"


def open_run(directory: pathlib.Path | str, plugins: Iterable[str] = ()) -> Run:
    """Open a run directory, finished or not.

    Args:
        directory: that `agile run` or `run` made.
        plugins: modules or Python files with the kinds that it was made with.

    Raises:
        BadInput: there is none.
    """
    directory = pathlib.Path(directory)
    if not directory.is_dir():
        raise BadInput(f"{directory}: no such run directory; `agile run EXPERIMENT.toml` makes one")
    return Run(directory, load_experiment(directory / "experiment.toml", plugins=plugins))


def run(
    experiment: Experiment | pathlib.Path | str,
    directory: pathlib.Path | str | None = None,
    *,
    workers: int | None = None,
    progress: Progress = silent,
) -> Run:
    """Run all stages, skipping what is done, and open the result.

    Args:
        experiment: or its file.
        directory: the run directory; runs/NAME when None.
        workers: processes that solve and simulate; none when None, then all work is done in this one.
        progress: is told how far the work has come.

    Raises:
        BadInput: the directory was made with other settings, or another process is at work in it.
    """
    if not isinstance(experiment, Experiment):
        experiment = load_experiment(experiment)
    directory = pathlib.Path("runs") / experiment.name if directory is None else pathlib.Path(directory)
    engine = "inline" if workers is None else "local"
    pipeline.run(experiment, directory, engine=engine, workers=workers, progress=progress)
    return open_run(directory)
