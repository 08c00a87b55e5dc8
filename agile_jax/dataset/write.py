"""Labels that were made elsewhere, as a dataset that `load` and the training accept."""

import pathlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from agile_jax.dataset.generate import commit
from agile_jax.dataset.settings import DatasetSettings
from agile_jax.dataset.shard import BRANCH_LENGTH, CAUSE_LENGTH, METHOD_LENGTH, LabelSettings, labels_at
from agile_jax.expert import ExpertSettings, Trajectory, lower_bound, rejection, verify
from agile_jax.expert.solution import Residuals
from agile_jax.files import sha256
from agile_jax.scene import POSE_SIZE, Scene, SceneSettings, facing, make_scene
from agile_jax.settings import BadInput
from agile_jax.store.artefact import ELSEWHERE
from agile_jax.store.npz import Arrays, npz_bytes
from agile_jax.store.parts import Made

SHOWN = 5  # trajectories that a message names
SHORTEST = 0.1  # [s] below which a gap is relative to this


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
        scene: which they must keep clear of; its target is where they end.
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
    residuals, bounds, bad = [], [], []
    for i, (trajectory, target) in enumerate(zip(trajectories, targets, strict=True)):
        start = np.asarray(trajectory.states[0, :POSE_SIZE], float)
        world = scene._replace(target=target)
        found = verify(world, expert, trajectory, start)
        if reason := rejection(found):
            bad.append(f"trajectory {i}: {reason.text}")
        residuals.append(found)
        bounds.append(lower_bound(start, facing(world, start).target, expert, expert.initial_velocity))
    if bad:
        more = f"\nand {len(bad) - SHOWN} others" if len(bad) > SHOWN else ""
        raise BadInput("\n".join(bad[:SHOWN]) + more)
    times, states, controls = (np.stack([np.asarray(t[i], float) for t in trajectories]) for i in range(3))
    duration, bound, count = times[:, -1], np.array(bounds), len(trajectories)
    return {
        "start": states[:, 0, :POSE_SIZE],
        "target": targets,
        "draws": np.tile(np.array([1, 0, 0], np.int64), (count, 1)),
        "times": times,
        "states": states,
        "controls": controls,
        "solved": np.ones(count, bool),
        "branch": np.full(count, ELSEWHERE, f"U{BRANCH_LENGTH}"),
        "method": np.full(count, ELSEWHERE, f"U{METHOD_LENGTH}"),
        "cause": np.full(count, "", f"U{CAUSE_LENGTH}"),
        "duration": duration,
        "lower_bound": bound,
        "gap": (duration - bound) / np.maximum(bound, SHORTEST),
        "objective": duration + expert.effort_weight * _effort(times, controls, np.array(expert.acceleration)),
        **{name: np.array([getattr(found, name) for found in residuals], float) for name in Residuals._fields},
    }


def _effort(
    times: Float[np.ndarray, "n nodes"], controls: Float[np.ndarray, "n controls 4"], limits: Float[np.ndarray, "4"]
) -> Float[np.ndarray, " n"]:
    """The integral of the sum of squared accelerations over their bounds [s]."""
    steps, share = np.diff(times), controls / limits
    if share.shape[1] == steps.shape[1]:
        return ((share**2).sum(-1) * steps).sum(-1)
    here, there = share[:, :-1], share[:, 1:]
    return ((here**2 + here * there + there**2).sum(-1) / 3 * steps).sum(-1)
