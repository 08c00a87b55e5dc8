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
from agile_jax.store.npz import load_npz
from agile_jax.training.kinematic_test.follow import OUTCOMES as TEST_OUTCOMES

_WIDTHS = {"qpos": (19,), "qvel": (18,), "torque": (12,), "reference": (2 * POSE_SIZE,), "saturated": (12,)}


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
    arrays = _load(path, start=("n", POSE_SIZE), outcome=("n",))
    _check_codes(path, arrays["outcome"], len(OUTCOME_NAMES))
    return Outcomes(arrays["start"].astype(float), arrays["outcome"].astype(int))


def load_episodes(path: pathlib.Path, outcomes: Outcomes) -> list[Episode]:
    """The episodes of `evaluation/<backend>-traces.npz`, cut to their lengths; those without a moment are left out.

    Raises:
        BadInput: the file is damaged or does not fit the outcomes.
    """
    shapes = {name: ("n", "K", *_WIDTHS.get(name, ())) for name in Trace._fields}
    arrays = _load(path, length=("n",), **shapes)
    length, steps = arrays["length"], arrays["time"].shape[1]
    if len(length) > len(outcomes.outcome) or (length < 0).any() or (length > steps).any():
        raise BadInput(f"{path}: the {len(length)} traces do not fit the {len(outcomes.outcome)} episodes")
    names = [OUTCOME_NAMES[code] for code in outcomes.outcome[: len(length)]]
    traces = [Trace(*(arrays[field][row, :end] for field in Trace._fields)) for row, end in enumerate(length)]
    return [Episode(row, name, traces[row]) for row, name in enumerate(names) if length[row] > 0]


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
    shapes = {"start": ("n", POSE_SIZE), "worst": ("k",), "worst_poses": ("k", "K", POSE_SIZE)}
    arrays = _load(path, **shapes, **{name: ("n",) for name in ("outcome", "arrival_time", "expert_time")})
    _check_codes(path, arrays["outcome"], len(TEST_OUTCOMES))
    _check_codes(path, arrays["worst"], len(arrays["outcome"]))
    ratio = arrays["arrival_time"].astype(float) / arrays["expert_time"]
    start, poses = arrays["start"].astype(float), arrays["worst_poses"].astype(float)
    return KinematicTest(start, arrays["outcome"].astype(int), ratio, arrays["worst"].astype(int), poses)


def load_test_errors(path: pathlib.Path) -> tuple[Float[np.ndarray, "m 4"], Float[np.ndarray, " m"]]:
    """Poses [m, rad] of held-out labels, and the mean square over the outputs of the error there.

    Raises:
        BadInput: the file is damaged or is not one.
    """
    arrays = _load(path, pose=("m", POSE_SIZE), error=("m",))
    return arrays["pose"].astype(float), arrays["error"].astype(float)


def load_columns(path: pathlib.Path) -> dict[str, Float[np.ndarray, " n"]]:
    """The columns of numbers of `evaluation/<backend>.npz`, by name.

    Raises:
        BadInput: the file is damaged or is not one.
    """
    return {name: a.astype(float) for name, a in _load(path).items() if a.dtype.kind in "bif" and a.ndim == 1}


def _load(path: pathlib.Path, **shapes: tuple[str | int, ...]) -> dict[str, np.ndarray]:
    """The arrays of an npz file, among them those named, of their shapes: a letter stands for one length in all."""
    arrays = load_npz(path, shapes)
    lengths: dict[str | int, int] = {}
    for name, shape in shapes.items():
        found = arrays[name].shape
        pairs = zip(shape, found, strict=False)  # their numbers are compared below
        wanted = [n if isinstance(n, int) else lengths.setdefault(n, length) for n, length in pairs]
        if len(found) != len(shape) or list(found) != wanted:
            raise BadInput(f"{path}: {name} has shape {found}, which does not fit {shape} and the other arrays")
    return arrays


def _check_codes(path: pathlib.Path, codes: np.ndarray, count: int) -> None:
    if not np.isin(codes, np.arange(count)).all():
        raise BadInput(f"{path}: holds {codes.max()} where numbers go from 0 to {count - 1}")
