"""A shard: the labels of some consecutive trajectories, as one npz file whose bytes are a pure function of settings,
seed and index.

Solve times are therefore not inside. Failed labels are kept with their cause; their arrays are zero.
"""

import io
import time
import zipfile
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from agile_jax.dataset.settings import DatasetSettings
from agile_jax.dataset.starts import draw_start
from agile_jax.expert import Expert, ExpertSettings, ExpertSolution, Residuals, make_expert
from agile_jax.files import hash_json
from agile_jax.scene import POSE_SIZE, Scene, SceneSettings, make_scene

SCHEMA = 4
NO_LABEL = {"trajectories", "split", "split_by", "label_kind", "samples", "start_seconds"}
CAUSE_LENGTH, BRANCH_LENGTH, METHOD_LENGTH = 480, 48, 24
RESIDUALS = Residuals._fields
NUMBERS = ("duration", "lower_bound", "gap", "objective", *RESIDUALS)


class BadShardError(ValueError):
    """The file is not the shard that it should be. The text says why."""


class ShardTask(NamedTuple):
    """What a worker needs to make one shard."""

    scene: SceneSettings
    expert: ExpertSettings
    dataset: DatasetSettings
    seed: int
    shard: int


class ShardResult(NamedTuple):
    """A shard's bytes and what must not be part of them."""

    data: bytes
    solve_times: tuple[float, ...]  # [s] per trajectory
    seconds: float  # the task took


def settings_key(scene: SceneSettings, expert: ExpertSettings, dataset: DatasetSettings, seed: int) -> str:
    """The hash that a shard carries; the number of trajectories is left out, so that a dataset can grow."""
    sections = {"scene": scene, "expert": expert, "dataset": dataset}
    return hash_json(
        {
            "schema": SCHEMA,
            "seed": seed,
            **{name: section.model_dump(mode="json", exclude=NO_LABEL) for name, section in sections.items()},
        }
    )


def trajectory_range(settings: DatasetSettings, index: int) -> range:
    """Indices of the trajectories in shard `index`."""
    return range(index * settings.shard_size, min((index + 1) * settings.shard_size, settings.trajectories))


def target_of(scene: SceneSettings, settings: DatasetSettings, index: int) -> np.ndarray:
    """The target of trajectory `index`, shape (4,) [m, rad]: the settings' in turn, the scene's if they have none."""
    targets = settings.targets or (scene.target,)
    return np.array(targets[index % len(targets)])


def shard_count(settings: DatasetSettings) -> int:
    """How many shards a dataset has."""
    return -(-settings.trajectories // settings.shard_size)


@lru_cache(maxsize=2)
def _expert(scene: SceneSettings, settings: ExpertSettings) -> tuple[Scene, Expert]:
    """One expert a process: building its solvers takes as long as several labels."""
    made = make_scene(scene)
    return made, make_expert(made, settings)


def make_shard(task: ShardTask) -> ShardResult:
    """Draw the starts of a shard and solve them."""
    began = time.perf_counter()
    scene, expert = _expert(task.scene, task.expert)
    solutions: list[ExpertSolution] = []
    starts, targets, accounts = [], [], []
    for i in trajectory_range(task.dataset, task.shard):
        target = target_of(task.scene, task.dataset, i)
        drawn = draw_start(scene._replace(target=target), task.scene, task.expert, task.dataset, task.seed, i)
        starts.append(drawn.poses[0])
        targets.append(target)
        accounts.append((drawn.attempted, drawn.rejected_collision, drawn.rejected_bounds))
        solutions.append(expert.solve(drawn.poses[0], target=target))
    arrays = {
        "key": np.array(settings_key(task.scene, task.expert, task.dataset, task.seed)),
        "index": np.array(trajectory_range(task.dataset, task.shard), dtype=np.int64),
        "start": np.array(starts),
        "target": np.array(targets),
        "draws": np.array(accounts, dtype=np.int64),
        "times": np.stack([s.trajectory.times for s in solutions]),
        "states": np.stack([s.trajectory.states for s in solutions]),
        "controls": np.stack([s.trajectory.controls for s in solutions]),
        "solved": np.array([s.status == "solved" for s in solutions]),
        "branch": np.array([s.branch[:BRANCH_LENGTH] for s in solutions], dtype=f"U{BRANCH_LENGTH}"),
        "method": np.array([s.method[:METHOD_LENGTH] for s in solutions], dtype=f"U{METHOD_LENGTH}"),
        "cause": np.array([s.cause[:CAUSE_LENGTH] for s in solutions], dtype=f"U{CAUSE_LENGTH}"),
        **{name: np.array([getattr(s, name) for s in solutions], float) for name in NUMBERS},
    }
    times = tuple(s.solve_time_s for s in solutions)
    return ShardResult(encode(arrays), times, time.perf_counter() - began)


def encode(arrays: dict[str, np.ndarray]) -> bytes:
    """An npz file; numpy stamps its members with a constant date, so equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def decode(
    data: bytes, expert: ExpertSettings, dataset: DatasetSettings, key: str, index: int
) -> dict[str, np.ndarray]:
    """The arrays in a shard's bytes, never unpickled.

    Raises:
        BadShardError: damaged, or not shard `index` of the dataset with this key.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError, SyntaxError) as error:
        raise BadShardError(f"unreadable ({type(error).__name__}: {error})") from None
    indices = trajectory_range(dataset, index)
    n, t = len(indices), expert.nodes
    shapes: dict[str, tuple[tuple[int, ...], str]] = {
        "key": ((), "U"),
        "index": ((n,), "i"),
        "start": ((n, POSE_SIZE), "f"),
        "target": ((n, POSE_SIZE), "f"),
        "draws": ((n, 3), "i"),
        "times": ((n, t + 1), "f"),
        "states": ((n, t + 1, 2 * POSE_SIZE), "f"),
        "controls": ((n, t + (expert.transcription != "zoh"), POSE_SIZE), "f"),
        "solved": ((n,), "b"),
        "branch": ((n,), "U"),
        "method": ((n,), "U"),
        "cause": ((n,), "U"),
        **{name: ((n,), "f") for name in NUMBERS},
    }
    for name, (shape, kind) in shapes.items():
        if name not in arrays:
            raise BadShardError(f"array {name} is missing")
        array = arrays[name]
        if array.shape != shape or array.dtype.kind != kind:
            raise BadShardError(
                f"array {name} has shape {array.shape} and type {array.dtype}, not {shape} and kind {kind}"
            )
        if kind == "f" and name != "min_clearance" and not np.isfinite(array).all():
            raise BadShardError(f"array {name} holds values that are not finite")
    if str(arrays["key"]) != key:
        raise BadShardError("made with other settings or another seed")
    if not np.array_equal(arrays["index"], indices):
        raise BadShardError("holds other trajectories")
    return arrays
