"""Making a dataset: one idempotent task a shard, committed atomically; the same call resumes and repairs.

shard-00000.npz ...   the labels (shard.py)
timing.json           how long they took; not part of the dataset's hash
manifest.json         settings, units, sha256 of every shard; written when all are there
summary.json          the account
quarantine/           files that were not what they should be

A dataset that grows keeps its labels; of one that shrinks the labels beyond stay in their files and are not loaded.
"""

import json
import logging
import pathlib
import platform
from importlib.metadata import version

import numpy as np

from agile_jax.dataset.dataset import load, read_manifest
from agile_jax.dataset.shard import SCHEMA, LabelSettings, ShardTask, labels_at, make_shard
from agile_jax.dataset.summary import summarise
from agile_jax.experiment import Experiment
from agile_jax.expert.feasible_poses import check_targets
from agile_jax.files import hash_json, read_json, sha256, write_json
from agile_jax.progress import Progress, silent
from agile_jax.scene import make_scene
from agile_jax.settings import BadInput
from agile_jax.store.artefact import ELSEWHERE, LABELS, covered, differences
from agile_jax.store.npz import NpzError, read_keyed, read_npz
from agile_jax.store.parts import OpenEngine, PartFile, Parts, complete, set_aside

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
    "method": "certified: closed-form least time; else the attempt of the general program that solved it",
    "clearance_violation, min_clearance": "[m]",
}
OWN_FILES = {"manifest.json", "summary.json", "timing.json", "quarantine", "stage.json"}

logger = logging.getLogger(__name__)


def shard_time_limit(settings: LabelSettings) -> float:
    """After which a shard's task counts as hung: a hundred times what it usually takes, at least a minute [s].

    More obstacles mean more routes, and more phases in each.
    """
    obstacles = max(1, len(settings.scene.obstacles))
    return max(60.0, 0.05 * settings.expert.nodes * settings.dataset.shard_size * obstacles**2)


def generate(
    experiment: Experiment, run_dir: pathlib.Path, open_engine: OpenEngine, progress: Progress = silent
) -> dict[str, object]:
    """Make what is missing of `dataset/` in a run directory, see `make_labels`."""
    settings = LabelSettings(experiment.scene, experiment.expert, experiment.dataset, experiment.seed)
    return make_labels(settings, run_dir / "dataset", open_engine, progress)


def make_labels(
    settings: LabelSettings, directory: pathlib.Path, open_engine: OpenEngine, progress: Progress = silent
) -> dict[str, object]:
    """Make what is missing of a dataset.

    Valid labels are kept, damaged or foreign files moved to quarantine/ and made again.

    Args:
        settings: what the labels are made from.
        directory: of the dataset.
        open_engine: opens the work engine, for example `functools.partial(open_engine, "local", 2)`; it is called only
            when a label is missing.
        progress: is told of every shard.

    Returns:
        The summary.

    Raises:
        BadInput: a target keeps less than the expert's margin.
        TasksFailedError: some shards could not be made; the others are kept.
        OSError: the disk is full or cannot be written; what is there stays valid.
    """
    check_targets(make_scene(settings.scene), settings.expert, settings.dataset.targets)
    directory.mkdir(parents=True, exist_ok=True)
    if (summary := _made_elsewhere(directory, settings)) is not None:
        return summary
    labels = labels_at(directory, settings, _listed(directory))
    beyond = _tidy(directory, labels)

    def task(numbers: np.ndarray) -> ShardTask:
        return ShardTask(settings, tuple(labels.items[numbers].tolist()))

    complete(labels, make_shard, task, open_engine, shard_time_limit(settings), progress, "trajectories")
    manifest = {"seed": settings.seed, "source": "expert", "settings": covered(LABELS, settings.tables())}
    return commit(directory, labels, manifest, beyond)


def commit(
    directory: pathlib.Path, labels: Parts, about: dict[str, object], beyond: dict[str, str]
) -> dict[str, object]:
    """Write manifest and summary of labels that are all there, and return the summary.

    Args:
        directory: of the dataset.
        labels: complete.
        about: what the manifest tells of their making.
        beyond: sha256 of files, by name, that hold labels which are not asked for.
    """
    files = labels.files()
    digest = hash_json({"key": labels.key, "shards": [labels.digest_of(file) for file in files]})
    manifest = about | {
        "schema_version": SCHEMA,
        "key": labels.key,
        "units": UNITS,
        "versions": {"casadi": version("casadi"), "numpy": np.__version__, "python": platform.python_version()},
        "shards": [_entry(file) for file in files],
        "beyond": [{"file": name, "sha256": sha} for name, sha in sorted(beyond.items())],
        "dataset_hash": digest,
    }
    summary = summarise(labels.arrays(), labels.notes, digest)
    _write_if_changed(directory / "manifest.json", manifest)
    _write_if_changed(directory / "summary.json", summary)
    return summary


def _made_elsewhere(directory: pathlib.Path, settings: LabelSettings) -> dict[str, object] | None:
    """The summary of labels that are not the expert's (write.py); None when they are.

    Raises:
        BadInput: they are damaged, which nobody here can repair, or of another scene or other limits.
    """
    manifest = read_manifest(directory)
    if manifest is None or manifest.get("source") != ELSEWHERE:
        return None
    if found := differences(manifest.get("settings"), settings.of_the_problem()):
        raise BadInput(f"{directory}: its labels were made elsewhere, with other settings: {'; '.join(found)}")
    dataset = load(directory)
    shards = [read_npz(directory / str(entry["file"])) for entry in manifest["shards"]]
    whole = {name: np.concatenate([rows[name] for rows in shards]) for name in shards[0] if name != "key"}
    summary = summarise(whole, {}, dataset.dataset_hash)
    _write_if_changed(directory / "summary.json", summary)
    return summary


def _entry(file: PartFile) -> dict[str, object]:
    return {
        "file": file.name,
        "sha256": file.sha256,
        "rows": len(file.rows["index"]),
        "trajectories": len(file.wanted),
        "solved": int(file.chosen()["solved"].sum()),
    }


def _listed(directory: pathlib.Path) -> dict[str, tuple[int, str]]:
    """Rows and sha256 of the shards, by name, as far as a manifest knows them."""
    manifest = read_manifest(directory)
    entries = [] if manifest is None else manifest["shards"]
    return {
        str(entry["file"]): (int(entry["rows"]), str(entry["sha256"]))
        for entry in entries
        if isinstance(entry, dict) and isinstance(entry.get("rows"), int) and {"file", "sha256"} <= entry.keys()
    }


def _tidy(directory: pathlib.Path, labels: Parts) -> dict[str, str]:
    """Set aside strange shards, and tell the sha256 of those with labels of this key beyond the ones asked for."""
    known, beyond = {file.name for file in labels.files()}, {}
    for path in sorted(directory.iterdir()):
        if path.name.startswith(".") and path.name.endswith(".tmp"):
            path.unlink()  # a write that a kill interrupted
        elif path.match("shard-*.npz") and path.name not in known:
            data = path.read_bytes()
            try:
                read_keyed(data, labels.key)
                beyond[path.name] = sha256(data)
            except NpzError as error:
                set_aside(path, str(error))
        elif path.name not in OWN_FILES | known:
            logger.warning("%s is not a part of the dataset and is left alone", path)
    return beyond


def _write_if_changed(path: pathlib.Path, value: dict[str, object]) -> None:
    if read_json(path) != json.loads(json.dumps(value)):
        write_json(path, value)
