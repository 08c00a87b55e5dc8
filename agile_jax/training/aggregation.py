"""Rounds of training, each on what the round before made necessary (Ross, Gordon and Bagnell, "A reduction of imitation
learning and structured prediction to no-regret online learning", AISTATS 2011).

A clone errs where its own errors have led it, and there the expert's paths are thin. After a round the policy is
rolled out; on the rollouts that failed or came nearest to an obstacle, poses shortly before and after are
given to the expert, whose paths from there join the training samples.

    training/round-0/           a training like any other, with its checkpoints
    training/round-0/queries/   the expert's answers (store/parts.py)
    training/                   the last round: what everybody loads

A round's checkpoint names the hash of all answers before it, so that a killed training goes on to the same bytes.
"""

import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agile_jax.dataset import Answers, unseen_starts
from agile_jax.expert import ExpertSettings, planning_margin
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.progress import Progress, silent
from agile_jax.scene import POSE_SIZE, Scene, SceneSettings, clearance, make_scene
from agile_jax.training.epochs import SI
from agile_jax.training.fit import Fitted, Labels, Watch, fit_policy
from agile_jax.training.kinematic_test.follow import ARRIVED, Followed, Follower
from agile_jax.training.kinematic_test.held_out import BATCH, DAGGER_STREAM
from agile_jax.training.settings import AggregationSettings, TrainingSettings

BEFORE = (0.8, 0.4, 0.2, 0.1, 0.0)  # [s] before the last pose that the expert may start from, on the way to the nearest
SPARE = 1e-3  # [m] beyond the expert's margin

Query = Callable[[PolicyParameters, int], np.ndarray]  # (parameters, round) -> poses (n, 4)
Ask = Callable[[np.ndarray, pathlib.Path], Answers]


class Rounds(NamedTuple):
    """The outcome of all rounds."""

    fitted: Fitted  # of the last one
    epochs: int  # of all
    seconds: float  # of all
    asked: int  # poses
    answered: int  # paths
    samples: int  # of the last one's training


def fit_rounds(
    policy: Policy,
    training: Labels,
    validation: Labels,
    training_settings: TrainingSettings,
    settings: AggregationSettings,
    identity: dict[str, Any],
    seed: int,
    directory: pathlib.Path,
    query: Query,
    ask: Ask,
    progress: Progress = silent,
    watch: tuple[int, Watch] | None = None,
    unit: np.ndarray = SI,
) -> Rounds:
    """`fit_policy`, as often as the settings say; without rounds, once.

    Args:
        policy, training, validation, training_settings, identity, seed, directory, progress, watch, unit: see
            `fit_policy`.
        settings: the rounds.
        query: poses to ask at; a pure function of parameters and round.
        ask: the expert's answers, kept in a folder.
    """
    parameters: PolicyParameters | None = None
    epochs, seconds, asked, answered = 0, 0.0, 0, 0
    digests: list[str] = []
    for number in range(settings.rounds + 1):
        last = number == settings.rounds
        folder = directory if last else directory / f"round-{number}"
        changes = {"epochs": settings.epochs, "learning_rate": settings.rate * training_settings.learning_rate}
        how = training_settings.model_copy(update=changes) if number else training_settings
        known = identity | ({"queries": digests} if digests else {})
        fitted = fit_policy(policy, training, validation, how, known, seed, folder, progress, watch, parameters, unit)
        parameters, epochs, seconds = fitted.parameters, epochs + len(fitted.rows), seconds + fitted.seconds
        if not last:
            answers = ask(query(parameters, number), folder / "queries")
            asked, answered, digests = asked + answers.asked, answered + len(answers.states), [*digests, answers.digest]
            states = answers.states.reshape(-1, 2 * POSE_SIZE)
            training = (
                np.concatenate([training[0], states[:, :POSE_SIZE]]),
                np.concatenate([training[1], states[:, POSE_SIZE:]]),
            )
    return Rounds(fitted, epochs, seconds, asked, answered, len(training[0]))


def make_query(
    follower: Follower,
    scene: SceneSettings,
    expert: ExpertSettings,
    settings: AggregationSettings,
    seed: int,
    dt: float,
    duration: float,
) -> Query:
    """Poses of the policy's own rollouts that are worth asking the expert about.

    Args:
        follower: rolls the policy out.
        scene, expert: settings of starts, obstacles and margin.
        settings: how many.
        seed: of the starts.
        dt: the follower's tick [s].
        duration: of a rollout [s].
    """
    world, margin = make_scene(scene), planning_margin(expert) + SPARE

    def query(parameters: PolicyParameters, number: int) -> np.ndarray:
        starts = unseen_starts(scene, expert, settings.starts, (seed, DAGGER_STREAM, number))
        ranked: list[tuple[tuple[bool, float], np.ndarray]] = []
        for first in range(0, len(starts), BATCH):
            part = starts[first : first + BATCH]
            followed = follower(parameters, part, np.full(len(part), duration))
            ranked += [
                (rank, visited_poses(world, followed.poses[i].astype(np.float64), margin, dt))
                for i, rank in enumerate(_ranks(followed))
            ]
        ranked.sort(key=lambda entry: entry[0])  # stable: equal ranks stay in the order of the starts
        poses = np.concatenate([poses for _, poses in ranked] or [np.empty((0, POSE_SIZE))])
        return poses[: settings.queries]

    return query


def visited_poses(scene: Scene, path: np.ndarray, margin: float, dt: float) -> np.ndarray:
    """Poses of a path, shape (K, 4), before and after it comes nearest to an obstacle, that keep the margin."""
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
