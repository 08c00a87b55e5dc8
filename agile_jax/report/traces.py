"""Reading an evaluation's episodes and traces back, and the choice of the episode that is shown.

Files may come from elsewhere: nothing is unpickled, shapes are checked, and a file that cannot be used is named.
"""

import pathlib
import zipfile
from typing import NamedTuple

import numpy as np

from agile_jax.geometry import rotation_2d
from agile_jax.scene import POSE_SIZE, Scene
from agile_jax.settings import BadInput

OUTCOMES = ("success", "collision", "fall", "timeout", "unstable")  # by the number in the episodes' `outcome`


class Outcomes(NamedTuple):
    """How the n episodes of an evaluation ended."""

    start: np.ndarray  # (n, 4) [m, rad]
    outcome: np.ndarray  # (n,) index into OUTCOMES


class Episode(NamedTuple):
    """One recorded episode of K moments."""

    row: int  # of the evaluation
    outcome: str
    time: np.ndarray  # (K,) [s]
    qpos: np.ndarray  # (K, 19) base position [m], quaternion wxyz, joints [rad]
    qvel: np.ndarray  # (K, 18) base twist [m/s, rad/s], joints [rad/s]
    torque: np.ndarray  # (K, 12) [N m]
    reference: np.ndarray  # (K, 8) pose and rates [m, rad, m/s, rad/s]
    clearance: np.ndarray  # (K,) [m]


_WIDTHS = {"qpos": 19, "qvel": 18, "torque": 12, "reference": 2 * POSE_SIZE}


def load_outcomes(path: pathlib.Path) -> Outcomes:
    """Starts and outcomes of `evaluation/<backend>.npz`.

    Raises:
        BadInput: the file is damaged or is not one.
    """
    arrays = _load(path, ("start", "outcome"))
    start, outcome = arrays["start"], arrays["outcome"]
    if start.ndim != 2 or start.shape[1] != POSE_SIZE or outcome.shape != start.shape[:1]:
        raise BadInput(
            f"{path}: start has shape {start.shape} and outcome {outcome.shape}, not (n, {POSE_SIZE}) and (n,)"
        )
    if not np.isin(outcome, np.arange(len(OUTCOMES))).all():
        raise BadInput(f"{path}: outcome holds numbers outside 0 to {len(OUTCOMES) - 1}")
    return Outcomes(start, outcome.astype(int))


def load_episodes(path: pathlib.Path, outcomes: Outcomes) -> list[Episode]:
    """The episodes of `evaluation/<backend>-traces.npz`, cut to their lengths; those without a moment are left out.

    Raises:
        BadInput: the file is damaged or does not fit the outcomes.
    """
    arrays = _load(path, ("time", "clearance", "length", *_WIDTHS))
    length = arrays["length"]
    count, steps = arrays["qpos"].shape[:2]
    expected = {"time": (count, steps), "clearance": (count, steps), "length": (count,)}
    expected |= {name: (count, steps, width) for name, width in _WIDTHS.items()}
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise BadInput(f"{path}: {name} has shape {arrays[name].shape}, not {shape}")
    if count > len(outcomes.outcome) or (length < 0).any() or (length > steps).any():
        raise BadInput(f"{path}: the {count} traces do not fit the {len(outcomes.outcome)} episodes")
    fields = [name for name in Episode._fields if name not in ("row", "outcome")]
    return [
        Episode(row, OUTCOMES[outcomes.outcome[row]], *(arrays[name][row, : int(length[row])] for name in fields))
        for row in range(count)
        if length[row] > 0
    ]


def below_obstacle(scene: Scene, position: np.ndarray) -> np.ndarray:
    """The underside [m] of the lowest obstacle above each position (K, 3), NaN where there is none. Shape (K,)."""
    underside = np.full(len(position), np.inf)
    for center, half, yaw in zip(scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True):
        local = (position[:, :2] - center[:2]) @ rotation_2d(np.asarray(yaw))
        inside = (np.abs(local) <= half[:2]).all(-1) & (position[:, 2] <= center[2] - half[2])
        underside = np.where(inside, np.minimum(underside, center[2] - half[2]), underside)
    return np.where(np.isfinite(underside), underside, np.nan)


def went_under(scene: Scene, episode: Episode) -> bool:
    """Whether the trunk's centre was at some moment below an obstacle."""
    return bool(np.isfinite(below_obstacle(scene, episode.qpos[:, :3])).any())


def choose_episode(scene: Scene, episodes: list[Episode]) -> Episode | None:
    """The first success that went under an obstacle, else the first success, else the first episode."""
    successes = [episode for episode in episodes if episode.outcome == "success"]
    under = [episode for episode in successes if went_under(scene, episode)]
    return next(iter(under or successes or episodes), None)


def _load(path: pathlib.Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in names}
    except KeyError as error:
        raise BadInput(f"{path}: the array {error.args[0]} is missing") from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{path}: cannot be read ({error})") from error
