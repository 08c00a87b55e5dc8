"""Making a dataset: one idempotent task a shard, committed atomically; the same call resumes and repairs.

shard-00000.npz ...   the labels (shard.py)
timing.json           how long they took; not part of the dataset's hash
manifest.json         settings, units, sha256 of every shard; written when all are there
summary.json          the account
quarantine/           files that were not what they should be
"""

import json
import logging
import os
import pathlib
import platform
from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib.metadata import version
from typing import Any

import numpy as np

from agile_jax.dataset.dataset import read_manifest
from agile_jax.dataset.settings import DatasetSettings
from agile_jax.dataset.shard import SCHEMA, BadShardError, ShardTask, decode, make_shard, settings_key, shard_count
from agile_jax.dataset.summary import summarise
from agile_jax.engine import Engine, TaskFailure, TasksFailedError
from agile_jax.expert import ExpertSettings
from agile_jax.expert.feasible_poses import check_targets
from agile_jax.files import hash_json, sha256, sync_folder, write_atomic, write_json
from agile_jax.progress import Progress, silent
from agile_jax.scene import SceneSettings, make_scene

UNITS = {
    "index": "of the trajectory in the order of drawing",
    "start, target": "x y z yaw [m m m rad]",
    "draws": "drawn, rejected for collision, rejected for bounds",
    "times": "[s]",
    "states": "x y z yaw and their rates [m m m rad, m/s m/s m/s rad/s]",
    "controls": "accelerations [m/s^2 m/s^2 m/s^2 rad/s^2], one an interval, or one a node and linear in between",
    "duration, lower_bound": "[s]",
    "gap": "(duration - lower_bound) / max(lower_bound, 0.1 s)",
    "objective": "duration + effort_weight * integral of sum (u_i / a_i)^2 dt [s]",
    "method": "certified: closed-form least time; else the rung of the general program's ladder",
    "clearance_violation, min_clearance": "[m]",
}
OWN_FILES = {"manifest.json", "summary.json", "timing.json", "quarantine", "stage.json"}

logger = logging.getLogger(__name__)


class IncompleteDatasetError(TasksFailedError):
    """Some shards could not be made; the others are kept. The text names them."""


def shard_time_limit(expert: ExpertSettings, dataset: DatasetSettings, obstacles: int) -> float:
    """After which a shard's task counts as hung: a hundred times what it usually takes, at least a minute [s].

    With the obstacles grow the number of routes and the phases of each.
    """
    return max(60.0, 0.05 * expert.nodes * dataset.shard_size * max(1, obstacles) ** 2)


def generate(
    scene_settings: SceneSettings,
    expert_settings: ExpertSettings,
    dataset_settings: DatasetSettings,
    seed: int,
    directory: pathlib.Path,
    engine: Callable[[], AbstractContextManager[Engine]],
    progress: Progress = silent,
) -> dict[str, Any]:
    """Make what is missing of a dataset and return its summary.

    Valid shards are kept, damaged or foreign ones moved to quarantine/ and made again. `engine` (for example
    `functools.partial(open_engine, "local", 2)`) is opened only when a shard is missing.

    Raises:
        BadInput: a target keeps less than the expert's margin.
        IncompleteDatasetError: tasks failed.
        OSError: the disk is full or cannot be written; what is there stays valid.
    """
    check_targets(make_scene(scene_settings), expert_settings, dataset_settings.targets)
    directory = pathlib.Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    key = settings_key(scene_settings, expert_settings, dataset_settings, seed)
    count = shard_count(dataset_settings)
    shards = _valid_shards(directory, expert_settings, dataset_settings, key, count)
    timing = _read_timing(directory, key)

    missing = [i for i in range(count) if i not in shards]
    done = sum(len(arrays["index"]) for arrays, _ in shards.values())
    progress("trajectories", done, dataset_settings.trajectories)
    failures: list[str] = []
    if missing:
        tasks = [ShardTask(scene_settings, expert_settings, dataset_settings, seed, i) for i in missing]
        with engine() as opened:
            timing["workers"] = opened.workers
            limit = shard_time_limit(expert_settings, dataset_settings, len(scene_settings.obstacles))
            for position, result in opened.map(make_shard, tasks, time_limit_s=limit):
                i = missing[position]
                if isinstance(result, TaskFailure):
                    failures.append(f"shard {i}: {result.cause}")
                    continue
                arrays = decode(result.data, expert_settings, dataset_settings, key, i)
                write_atomic(directory / shard_name(i), result.data)
                timing["shards"][str(i)] = {
                    "seconds": result.seconds,
                    "solve_ms": [round(1e3 * t, 3) for t in result.solve_times],
                }
                write_json(directory / "timing.json", timing)
                shards[i] = (arrays, sha256(result.data))
                done += len(arrays["index"])
                progress("trajectories", done, dataset_settings.trajectories)
    if failures:
        raise IncompleteDatasetError(
            f"{len(failures)} of {count} shards could not be made ({'; '.join(sorted(failures))}); "
            f"the others are kept in {directory}, and the same command tries again"
        )

    ordered = [shards[i] for i in range(count)]
    manifest = _manifest(scene_settings, expert_settings, dataset_settings, seed, key, ordered)
    summary = summarise([arrays for arrays, _ in ordered], timing, manifest["dataset_hash"], dataset_settings, seed)
    _write_if_changed(directory / "manifest.json", manifest)
    _write_if_changed(directory / "summary.json", summary)
    return summary


def shard_name(index: int) -> str:
    """The file name of a shard."""
    return f"shard-{index:05d}.npz"


def _valid_shards(
    directory: pathlib.Path, expert: ExpertSettings, settings: DatasetSettings, key: str, count: int
) -> dict[int, tuple[dict[str, np.ndarray], str]]:
    """Arrays and sha256 of the shards that are what they should be; others, and strange shards, go to quarantine."""
    manifest = read_manifest(directory)
    listed = {}
    if manifest is not None and manifest.get("key") == key:
        listed = {e["file"]: e.get("sha256") for e in manifest["shards"] if isinstance(e, dict) and "file" in e}
    valid = {}
    names = {shard_name(i): i for i in range(count)}
    for path in sorted(directory.iterdir()):
        if path.name.startswith(".") and path.name.endswith(".tmp"):
            path.unlink()  # a write that a kill interrupted
        elif path.name in names:
            i = names[path.name]
            try:
                data = path.read_bytes()
                digest = sha256(data)
                arrays = decode(data, expert, settings, key, i)
                # A dataset that grows may fill up its last shard: then the manifest is of the shorter one.
                if listed.get(path.name, digest) != digest:
                    raise BadShardError("its sha256 is not the manifest's")
                valid[i] = (arrays, digest)
            except (OSError, BadShardError) as error:
                _quarantine(path, str(error))
        elif path.match("shard-*.npz"):
            _quarantine(path, "it does not belong to this dataset")
        elif path.name not in OWN_FILES:
            logger.warning("%s is not a part of the dataset and is left alone", path)
    return valid


def _quarantine(path: pathlib.Path, cause: str) -> None:
    folder = path.parent / "quarantine"
    folder.mkdir(exist_ok=True)
    number = 0
    while (target := folder / f"{path.name}.{number}").exists():
        number += 1
    os.replace(path, target)
    sync_folder(path.parent)
    logger.warning("%s moved to quarantine/%s: %s", path, target.name, cause)


def _read_timing(directory: pathlib.Path, key: str) -> dict[str, Any]:
    """How long the shards took, as far as it is known."""
    try:
        timing = json.loads((directory / "timing.json").read_text())
        if timing["key"] == key and isinstance(timing["shards"], dict) and int(timing["workers"]) > 0:
            return dict(timing)
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return {"key": key, "workers": 1, "shards": {}}


def _manifest(
    scene: SceneSettings,
    expert: ExpertSettings,
    dataset: DatasetSettings,
    seed: int,
    key: str,
    shards: list[tuple[dict[str, np.ndarray], str]],
) -> dict[str, Any]:
    entries = [
        {
            "file": shard_name(i),
            "sha256": digest,
            "trajectories": len(arrays["index"]),
            "solved": int(arrays["solved"].sum()),
        }
        for i, (arrays, digest) in enumerate(shards)
    ]
    return {
        "schema_version": SCHEMA,
        "key": key,
        "settings": {
            "scene": scene.model_dump(mode="json"),
            "expert": expert.model_dump(mode="json"),
            "dataset": dataset.model_dump(mode="json"),
            "seed": seed,
        },
        "units": UNITS,
        "versions": {"casadi": version("casadi"), "numpy": np.__version__, "python": platform.python_version()},
        "shards": entries,
        "dataset_hash": hash_json({"key": key, "shards": [entry["sha256"] for entry in entries]}),
    }


def _write_if_changed(path: pathlib.Path, value: Any) -> None:
    try:
        same = json.loads(path.read_text()) == json.loads(json.dumps(value))
    except (OSError, ValueError):
        same = False
    if not same:
        write_json(path, value)
