"""Reading back what the stages of a run left: episodes, traces, the kinematic test.

Files may come from elsewhere: nothing is unpickled, shapes are checked, and a file that cannot be used is named.
"""

import pathlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from agile_jax.report.under_obstacles import went_under
from agile_jax.scene import POSE_SIZE, Scene
from agile_jax.settings import BadInput
from agile_jax.simulation import OUTCOME_NAMES, SUCCESS, Trace
from agile_jax.store.npz import NpzError, read_npz
from agile_jax.training.kinematic_test.follow import OUTCOMES as TEST_OUTCOMES

_WIDTHS = {"qpos": 19, "qvel": 18, "torque": 12, "reference": 2 * POSE_SIZE, "saturated": 12}


class Outcomes(NamedTuple):
    """How the n episodes of an evaluation ended."""

    start: Float[np.ndarray, "n 4"]  # [m, rad]
    outcome: Int[np.ndarray, " n"]  # index into OUTCOME_NAMES


class Episode(NamedTuple):
    """One recorded episode of an evaluation."""

    row: int  # of the evaluation
    outcome: str
    trace: Trace


class KinematicTest(NamedTuple):
    """The n runs of the kinematic test from held-out starts, and the poses of the k worst of them."""

    start: Float[np.ndarray, "n 4"]  # [m, rad]
    outcome: Int[np.ndarray, " n"]  # index into the test's OUTCOMES
    ratio: Float[np.ndarray, " n"]  # arrival time over the expert's; NaN or infinity where one has none
    worst: Int[np.ndarray, " k"]  # rows
    worst_poses: Float[np.ndarray, "k K 4"]  # [m, rad]


def load_outcomes(path: pathlib.Path) -> Outcomes:
    """Starts and outcomes of `evaluation/<backend>.npz`.

    Raises:
        BadInput: the file is damaged or is not one.
    """
    arrays = load_arrays(path, "start", "outcome")
    start, outcome = arrays["start"], arrays["outcome"]
    _check(path, "start", start, (len(outcome), POSE_SIZE))
    _check_codes(path, outcome, len(OUTCOME_NAMES))
    return Outcomes(start.astype(float), outcome.astype(int))


def load_episodes(path: pathlib.Path, outcomes: Outcomes) -> list[Episode]:
    """The episodes of `evaluation/<backend>-traces.npz`, cut to their lengths; those without a moment are left out.

    Raises:
        BadInput: the file is damaged or does not fit the outcomes.
    """
    arrays = load_arrays(path, "length", *Trace._fields)
    length = arrays["length"]
    count, steps = arrays["time"].shape[:2] if arrays["time"].ndim > 1 else (len(length), -1)
    _check(path, "length", length, (count,))
    for name in Trace._fields:
        _check(path, name, arrays[name], (count, steps, *([_WIDTHS[name]] if name in _WIDTHS else [])))
    if count > len(outcomes.outcome) or (length < 0).any() or (length > steps).any():
        raise BadInput(f"{path}: the {count} traces do not fit the {len(outcomes.outcome)} episodes")
    names = [OUTCOME_NAMES[code] for code in outcomes.outcome[:count]]
    return [
        Episode(row, name, Trace(*(arrays[field][row, : int(length[row])] for field in Trace._fields)))
        for row, name in enumerate(names)
        if length[row] > 0
    ]


def choose_episode(scene: Scene, episodes: list[Episode]) -> Episode | None:
    """The first success that went under an obstacle, else the first success, else the first episode."""
    successes = [episode for episode in episodes if episode.outcome == OUTCOME_NAMES[SUCCESS]]
    under = [episode for episode in successes if went_under(scene, episode.trace.qpos[:, :3])]
    return next(iter(under or successes or episodes), None)


def load_kinematic_test(path: pathlib.Path) -> KinematicTest:
    """The rows of the learner's own test.

    Raises:
        BadInput: the file is damaged or is not one.
    """
    arrays = load_arrays(path, "start", "outcome", "arrival_time", "expert_time", "worst", "worst_poses")
    count, worst = len(arrays["outcome"]), arrays["worst"]
    _check(path, "start", arrays["start"], (count, POSE_SIZE))
    for name in ("arrival_time", "expert_time"):
        _check(path, name, arrays[name], (count,))
    _check(path, "worst_poses", arrays["worst_poses"], (len(worst), *arrays["worst_poses"].shape[1:2], POSE_SIZE))
    _check_codes(path, arrays["outcome"], len(TEST_OUTCOMES))
    if not np.isin(worst, np.arange(count)).all():
        raise BadInput(f"{path}: worst names rows outside 0 to {count - 1}")
    ratio = arrays["arrival_time"].astype(float) / arrays["expert_time"]
    start, poses = arrays["start"].astype(float), arrays["worst_poses"].astype(float)
    return KinematicTest(start, arrays["outcome"].astype(int), ratio, worst.astype(int), poses)


def load_test_errors(path: pathlib.Path) -> tuple[Float[np.ndarray, "m 4"], Float[np.ndarray, " m"]]:
    """Poses [m, rad] of held-out labels, and the mean square over the outputs of the error there.

    Raises:
        BadInput: the file is damaged or is not one.
    """
    arrays = load_arrays(path, "pose", "error")
    _check(path, "pose", arrays["pose"], (len(arrays["error"]), POSE_SIZE))
    return arrays["pose"].astype(float), arrays["error"].astype(float)


def load_columns(path: pathlib.Path) -> dict[str, Float[np.ndarray, " n"]]:
    """The columns of numbers of `evaluation/<backend>.npz`, by name.

    Raises:
        BadInput: the file is damaged or is not one.
    """
    arrays = load_arrays(path)
    return {name: a.astype(float) for name, a in arrays.items() if a.dtype.kind in "bif" and a.ndim == 1}


def load_arrays(path: pathlib.Path, *names: str) -> dict[str, np.ndarray]:
    """The arrays of an npz file, among them those that are named.

    Raises:
        BadInput: the file cannot be read, or an array is missing.
    """
    try:
        arrays = read_npz(path)
    except NpzError as error:
        raise BadInput(f"{path}: {error}") from error
    missing = [name for name in names if name not in arrays]
    if missing:
        raise BadInput(f"{path}: the array {missing[0]} is missing")
    return arrays


def _check(path: pathlib.Path, name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise BadInput(f"{path}: {name} has shape {array.shape}, not {shape}")


def _check_codes(path: pathlib.Path, outcome: np.ndarray, count: int) -> None:
    if outcome.ndim != 1 or not np.isin(outcome, np.arange(count)).all():
        raise BadInput(f"{path}: outcome must be one axis of numbers from 0 to {count - 1}")
