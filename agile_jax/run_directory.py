"""A run directory: which stages it holds, made with which settings, and who is working in it.

Each stage's folder has a record `stage.json` of its settings and their hash, written before the work begins. A stage
is done when its summary is there and the record has the same hash. Other settings never mix with what is there: the
folder is refused or moved aside.
"""

import fcntl
import importlib.metadata
import os
import pathlib
import platform
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple

from agile_jax.experiment import STAGES, Experiment, experiment_hash, stage_hash, stage_settings, to_toml
from agile_jax.files import read_json, sha256, write_atomic, write_json
from agile_jax.robot.settings import OWN
from agile_jax.settings import BadInput

State = Literal["done", "begun", "new", "other settings"]


class StagePaths(NamedTuple):
    """Where a stage keeps its things."""

    folder: pathlib.Path
    record: pathlib.Path  # {stage, hash, settings}
    summary: pathlib.Path  # there when the stage is done


def stage_paths(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> StagePaths:
    """The paths of a stage. Evaluations by different backends stand side by side in one folder."""
    if stage == "evaluation":
        folder, backend = run_dir / "evaluation", experiment.evaluation.backend
        return StagePaths(folder, folder / "stages" / f"{backend}.json", folder / f"{backend}.json")
    if stage == "report":
        return StagePaths(run_dir / "figures", run_dir / "figures" / "stage.json", run_dir / "report.html")
    folder = run_dir / stage
    return StagePaths(folder, folder / "stage.json", folder / "summary.json")


def record_hash(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> str:
    """The hash that the record must have for the result to hold. A report also depends on what it shows."""
    own = stage_hash(experiment, stage)
    if stage != "report":
        return own
    results = [run_dir / "dataset/summary.json", run_dir / "training/summary.json", *run_dir.glob("evaluation/*.json")]
    return sha256("".join([own, *(sha256(path.read_bytes()) for path in sorted(results) if path.is_file())]).encode())


def stage_state(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> State:
    """What the run directory holds of a stage.

    "other settings" is said of the dataset and the training only; evaluations and reports are quick enough to be made
    anew.
    """
    paths = stage_paths(run_dir, experiment, stage)
    record = read_json(paths.record)
    if record is not None and record.get("hash") == record_hash(run_dir, experiment, stage):
        finished = paths.summary.is_file() if stage == "report" else read_json(paths.summary) is not None
        return "done" if finished else "begun"
    if stage in ("evaluation", "report") or not _holds_anything(paths.folder):
        return "new"
    return "other settings"


def refuse_other_settings(run_dir: pathlib.Path, experiment: Experiment, stages: tuple[str, ...]) -> None:
    """Raise BadInput for a folder made with other settings: every differing key, both values, the ways out."""
    for stage in stages:
        if stage_state(run_dir, experiment, stage) != "other settings":
            continue
        paths = stage_paths(run_dir, experiment, stage)
        there = (read_json(paths.record) or {}).get("settings")
        if not isinstance(there, dict):
            found = [f"  it has no readable {paths.record.name}, so nothing tells with which settings it was made"]
        else:
            found = _differences(there, stage_settings(experiment, stage))
        raise BadInput(
            f"{paths.folder}: was made with other settings:\n"
            + "\n".join(found)
            + "\nuse `--run-dir DIR` for a new run directory, or `--overwrite` to move the old folder aside"
        )


def move_aside(folder: pathlib.Path) -> pathlib.Path:
    """Rename `folder` to the first free `<folder>.old-<n>`, n = 1, 2, ..., and return that."""
    number = 1
    while (aside := folder.with_name(f"{folder.name}.old-{number}")).exists():
        number += 1
    folder.rename(aside)
    return aside


def write_record(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> None:
    """Note the settings with which the stage's folder is made."""
    record = {
        "stage": stage,
        "hash": record_hash(run_dir, experiment, stage),
        "settings": stage_settings(experiment, stage),
    }
    write_json(stage_paths(run_dir, experiment, stage).record, record)


def write_identity(run_dir: pathlib.Path, experiment: Experiment) -> None:
    """Write experiment.toml (all settings, resolved), the robot's own files, and environment.json (hashes, seed,
    versions, machine).
    """
    write_atomic(run_dir / "experiment.toml", to_toml(with_own_robot(run_dir, experiment)).encode())
    write_json(
        run_dir / "environment.json",
        {
            "experiment_hash": experiment_hash(experiment),
            "stage_hashes": {stage: stage_hash(experiment, stage) for stage in STAGES},
            "seed": experiment.seed,
            "python": platform.python_version(),
            "platform": platform.platform(),
            "machine": platform.machine(),
            "cpu_count": os.cpu_count(),
            "packages": package_versions(),
        },
    )


def with_own_robot(run_dir: pathlib.Path, experiment: Experiment) -> Experiment:
    """Copy the files of another robot into `run_dir`/robot, for the run to be opened elsewhere; the experiment with
    the copy's path, relative to `run_dir`.
    """
    if experiment.robot.name == OWN:
        return experiment
    from agile_jax.robot import copy_robot  # loads MuJoCo

    copied = pathlib.Path(copy_robot(experiment.robot, run_dir / "robot").name)
    name = copied.relative_to(os.path.abspath(run_dir)).as_posix()
    return experiment.model_copy(update={"robot": experiment.robot.model_copy(update={"name": name})})


def package_versions() -> dict[str, str]:
    """The installed versions of agile_jax and of what it requires."""
    versions = {"agile_jax": importlib.metadata.version("agile_jax")}
    for requirement in importlib.metadata.requires("agile_jax") or []:
        match = re.match(r"[A-Za-z0-9._-]+", requirement)
        if match and "extra ==" not in requirement:
            versions[match.group()] = importlib.metadata.version(match.group())
    return versions


@contextmanager
def locked(run_dir: pathlib.Path) -> Iterator[None]:
    """Hold the run directory alone. The kernel frees the lock when the process ends, however it ends.

    Raises:
        BadInput: another process holds it.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    with open(run_dir / ".lock", "a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            holder = file.read(32).strip() or "unknown"
            raise BadInput(
                f"{run_dir}: another process (pid {holder}) is at work here; wait for it, or use another `--run-dir`"
            ) from None
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield


def _holds_anything(folder: pathlib.Path) -> bool:
    """Whether a folder holds more than what a kill leaves of the very first write."""
    if not folder.is_dir():
        return folder.exists()
    return any(not (path.name.startswith(".") and path.name.endswith(".tmp")) for path in folder.iterdir())


def _differences(there: dict[str, Any], asked: dict[str, Any]) -> list[str]:
    old, new = _leaves(there), _leaves(asked)
    keys = [key for key in dict.fromkeys([*old, *new]) if old.get(key, "absent") != new.get(key, "absent")]
    return [f"  {key}: {old.get(key, 'absent')!r} there, {new.get(key, 'absent')!r} asked for" for key in keys]


def _leaves(value: Any, key: str = "") -> dict[str, Any]:
    if isinstance(value, dict) and value:
        return {
            k: v for name, item in value.items() for k, v in _leaves(item, f"{key}.{name}" if key else name).items()
        }
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return {k: v for i, item in enumerate(value) for k, v in _leaves(item, f"{key}.{i}").items()}
    return {key: value}
