"""Labels that were made elsewhere, as a dataset that `load` and the training accept."""

import pathlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from agile_jax.dataset.generate import commit
from agile_jax.dataset.settings import DatasetSettings
from agile_jax.dataset.shard import LabelSettings, labels_at, rows_of
from agile_jax.expert import ExpertSettings, Trajectory, lower_bound, rejection, verify
from agile_jax.expert.own import effort
from agile_jax.expert.solution import solved
from agile_jax.files import sha256
from agile_jax.scene import POSE_SIZE, Scene, SceneSettings, facing, make_scene
from agile_jax.settings import BadInput
from agile_jax.store.artefact import ELSEWHERE
from agile_jax.store.npz import Arrays, npz_bytes
from agile_jax.store.parts import Made

SHOWN = 5  # trajectories that a message names


def write(
    directory: pathlib.Path | str,
    trajectories: Sequence[Trajectory],
    scene: SceneSettings,
    expert: ExpertSettings,
    targets: Float[np.ndarray, "n 4"] | None = None,
    seed: int = 0,
) -> dict[str, object]:
    """Verify trajectories and write them as a dataset; in `RUN_DIR/dataset` a run goes on from them.

    Args:
        directory: new or empty.
        trajectories: of one number of intervals T: times (T+1,) [s]; states (T+1, 8), pose and rates [m, rad, m/s,
            rad/s]; controls (T, 4), constant over an interval, or (T+1, 4), linear between nodes [m/s^2, rad/s^2].
        scene: which they must keep clear of; its target is where they end. If a run is to go on from them, give
            `experiment.scene`: an experiment works out how low and fast its robot can crouch.
        expert: whose bounds, margin, end conditions and transcription they must keep.
        targets: poses where they end [m, rad], if not at the scene's target.
        seed: of the split in training, validation and test.

    Returns:
        The summary.

    Raises:
        BadInput: there is something in the folder, or trajectories do not pass the check, which names them.
    """
    directory = pathlib.Path(directory)
    if directory.exists() and any(directory.iterdir()):
        raise BadInput(f"{directory}: is not empty; labels made elsewhere are written to a new folder")
    if not trajectories:
        raise BadInput("there are no trajectories to write")
    ends = np.tile(scene.target, (len(trajectories), 1)) if targets is None else np.asarray(targets, float)
    rows = _rows(trajectories, make_scene(scene), expert, ends)
    dataset = DatasetSettings(trajectories=len(trajectories))
    settings = LabelSettings(scene, expert, dataset, seed)
    labels = labels_at(directory, settings, made_elsewhere=sha256(npz_bytes(rows)))
    for numbers in labels.missing():
        labels.add(numbers, Made({name: values[numbers] for name, values in rows.items()}))
    about = {"seed": seed, "source": ELSEWHERE, "settings": settings.of_the_problem()}
    return commit(directory, labels, about, {})


def _rows(
    trajectories: Sequence[Trajectory], scene: Scene, expert: ExpertSettings, targets: Float[np.ndarray, "n 4"]
) -> Arrays:
    """The columns of the shards; BadInput for trajectories that do not pass."""
    shapes = {tuple(np.shape(array) for array in trajectory) for trajectory in trajectories}
    if len(shapes) > 1:
        raise BadInput(f"trajectories must have one number of intervals; their arrays have the shapes {sorted(shapes)}")
    solutions, bad = [], []
    for i, (given, target) in enumerate(zip(trajectories, targets, strict=True)):
        path = Trajectory(*(np.asarray(array, float) for array in given))
        start, world = path.states[0, :POSE_SIZE], scene._replace(target=target)
        residuals = verify(world, expert, path, start)
        if reason := rejection(residuals):
            bad.append(f"trajectory {i}: {reason.text}")
        bound = lower_bound(start, facing(world, start).target, expert, expert.initial_velocity)
        objective = float(path.times[-1]) + expert.effort_weight * effort(path, expert.limits.acceleration)
        solutions.append(solved(path, residuals, bound, ELSEWHERE, objective, ELSEWHERE, ()))
    if bad:
        more = f"\nand {len(bad) - SHOWN} others" if len(bad) > SHOWN else ""
        raise BadInput("\n".join(bad[:SHOWN]) + more)
    return {
        "start": np.array([one.trajectory.states[0, :POSE_SIZE] for one in solutions]),
        "target": targets,
        "draws": np.tile(np.array([1, 0, 0], np.int64), (len(solutions), 1)),
        **rows_of(solutions),
    }
