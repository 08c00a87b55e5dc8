"""Rounds of training, each on what the round before made necessary (Ross, Gordon and Bagnell, "A reduction of imitation
learning and structured prediction to no-regret online learning", AISTATS 2011).

A clone errs where its own errors have led it, and there the expert's paths are thin. After a round the policy is
followed by a kinematic robot; on the runs that failed or came nearest to an obstacle, poses shortly before and after
are given to the expert, whose paths from there join the training samples.

    training/round-0/           a training like any other, with its checkpoints
    training/round-0/queries/   the expert's answers (store/parts.py)
    training/                   the last round: what everybody loads

A round's checkpoint names the hash of all answers before it, so that a killed training goes on to the same bytes.
"""

import pathlib
import tempfile
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.dataset import Answers, ask
from agile_jax.expert import planning_margin
from agile_jax.policy.network import PolicyParameters
from agile_jax.progress import Progress, silent
from agile_jax.scene import POSE_SIZE, Scene, clearance, make_scene, streams
from agile_jax.store.parts import OpenEngine
from agile_jax.training.fit import FitProblem, Fitted, Keeping, fit_policy
from agile_jax.training.kinematic_test.follow import ARRIVED, Followed, Follower
from agile_jax.training.kinematic_test.held_out import BATCH, KinematicTest
from agile_jax.training.samples import Samples
from agile_jax.training.settings import AggregationSettings

BEFORE = (0.8, 0.4, 0.2, 0.1, 0.0)  # [s] before the last pose that the expert may start from, on the way to the nearest
SPARE = 1e-3  # [m] beyond the expert's margin


class Rounds(NamedTuple):
    """The outcome of all rounds."""

    fitted: Fitted  # of the last one
    epochs: int  # of all
    seconds: float  # of all
    asked: int  # poses
    answered: int  # paths
    samples: int  # of the last one's training


@dataclass(frozen=True, eq=False)
class Aggregation:
    """What is asked of the expert, and how it is answered.

    Attributes:
        test: scene, expert, seed and the kinematic robot.
        settings: how many rounds, starts and poses.
        duration: of a run of the robot [s].
        engine: opens the work engine for the expert's answers.
    """

    test: KinematicTest
    settings: AggregationSettings
    duration: float
    engine: OpenEngine

    def query(self, parameters: PolicyParameters, number: int) -> Float[np.ndarray, "n 4"]:
        """Poses [m, rad] of the policy's own runs that are worth asking the expert about, after round `number`."""
        test = self.test
        world, margin = make_scene(test.scene_settings), planning_margin(test.expert) + SPARE
        starts = test.starts(self.settings.starts, streams.AGGREGATION_STARTS, number)
        ranked: list[tuple[tuple[bool, float], Float[np.ndarray, "k 4"]]] = []
        for first in range(0, len(starts), BATCH):
            part = starts[first : first + BATCH]
            followed = self._follower(parameters, part, np.full(len(part), self.duration))
            ranked += [
                (rank, visited_poses(world, followed.poses[i].astype(np.float64), margin, test.settings.dt))
                for i, rank in enumerate(_ranks(followed))
            ]
        ranked.sort(key=lambda entry: entry[0])  # stable: equal ranks stay in the order of the starts
        poses = np.concatenate([poses for _, poses in ranked] or [np.empty((0, POSE_SIZE))])
        return poses[: self.settings.queries]

    @cached_property
    def _follower(self) -> Follower:
        return self.test.follower(self.duration)

    def answer(
        self, poses: Float[np.ndarray, "n 4"], folder: pathlib.Path | None, progress: Progress = silent
    ) -> Answers:
        """The expert's paths from poses [m, rad], kept in a folder, or nowhere."""
        with tempfile.TemporaryDirectory(prefix="agile-answers-") as scratch:
            where = pathlib.Path(scratch) if folder is None else folder
            return ask(self.test.scene_settings, self.test.expert, poses, self.engine, where, progress)


def fit_rounds(
    problem: FitProblem, aggregation: Aggregation, keeping: Keeping | None = None, progress: Progress = silent
) -> Rounds:
    """`fit_policy`, as often as the rounds' settings say; without rounds, once.

    Args:
        problem: of the first round.
        aggregation: the rounds.
        keeping: where the last round is kept, the others below; nowhere when None.
        progress: is told of every epoch and answer.
    """
    settings, rate = aggregation.settings, problem.settings.learning_rate
    later = problem.settings.model_copy(update={"epochs": settings.epochs, "learning_rate": settings.rate * rate})
    epochs, seconds, asked, answered = 0, 0.0, 0, 0
    digests: list[str] = []
    for number in range(settings.rounds + 1):
        last = number == settings.rounds
        kept = keeping.inside("" if last else f"round-{number}", {"queries": digests}) if keeping else None
        fitted = fit_policy(problem, kept, progress)
        epochs, seconds = epochs + len(fitted.rows), seconds + fitted.seconds
        if not last:
            poses = aggregation.query(fitted.parameters, number)
            answers = aggregation.answer(poses, kept.directory / "queries" if kept else None, progress)
            asked, answered, digests = asked + answers.asked, answered + len(answers.states), [*digests, answers.digest]
            more = _joined(problem.training, answers)
            problem = replace(problem, training=more, settings=later, initial=fitted.parameters)
    return Rounds(fitted, epochs, seconds, asked, answered, len(problem.training.inputs))


def _joined(training: Samples, answers: Answers) -> Samples:
    """The samples, and the velocities along the expert's answers."""
    states = answers.states.reshape(-1, 2 * POSE_SIZE)
    inputs = np.concatenate([training.inputs, states[:, :POSE_SIZE]])
    return Samples(inputs, np.concatenate([training.outputs, states[:, POSE_SIZE:]]))


def visited_poses(
    scene: Scene, path: Float[np.ndarray, "ticks 4"], margin: float, dt: float
) -> Float[np.ndarray, "k 4"]:
    """Poses of a path before and after it comes nearest to an obstacle, that keep the margin.

    Args:
        scene: obstacles and bounds.
        path: poses at every tick [m, rad].
        margin: [m].
        dt: tick [s].
    """
    distances = np.asarray(clearance(scene, path))
    free = (distances >= margin) & ((path >= scene.lower) & (path <= scene.upper)).all(-1)
    nearest = int(distances.argmin())
    before = np.flatnonzero(free[: nearest + 1])
    after = nearest + np.flatnonzero(free[nearest:])
    chosen = [before[-1] - round(seconds / dt) for seconds in BEFORE] if len(before) else []
    chosen += [int(after[0])] if len(after) else []
    return path[sorted({k for k in chosen if k >= 0 and free[k]})]


def _ranks(followed: Followed) -> list[tuple[bool, float]]:
    """The lower, the more worth a question: those that failed first, then by the least clearance."""
    return [
        (bool(outcome == ARRIVED), float(distance))
        for outcome, distance in zip(followed.outcome, followed.min_clearance, strict=True)
    ]
