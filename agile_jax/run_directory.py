"""A run directory: which stages it holds, made with which settings, and who is working in it.

Each stage's folder has a record `stage.json` (store/record.py): with which settings it was made, and, when it is done,
the sha256 of every file of its result. A stage is done when its record has the right key and the files are sound.
Damage is repaired by the command that makes the stage. Other settings never mix with what is there: a dataset or a
training is refused or moved aside.
"""

import fcntl
import importlib.metadata
import os
import pathlib
import platform
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Literal, NamedTuple

from agile_jax.experiment import Experiment, experiment_hash, to_toml
from agile_jax.files import read_json, write_atomic, write_json
from agile_jax.robot.settings import OWN
from agile_jax.settings import BadInput
from agile_jax.store.artefact import (
    ELSEWHERE,
    EPISODES,
    EPOCHS,
    FIGURES,
    KINEMATIC_TEST,
    LABELS,
    Artefact,
    amounts,
    described,
    differences,
    keys,
)
from agile_jax.store.record import Record, damaged, list_files, read_record, write_record
from agile_jax.training.finished import read_finished

State = Literal["done", "begun", "new", "outdated", "other settings"]
ARTEFACTS_OF: dict[str, tuple[Artefact, ...]] = {  # the first one names the stage's result
    "dataset": (LABELS,),
    "training": (EPOCHS, KINEMATIC_TEST),
    "evaluation": (EPISODES,),
    "report": (FIGURES,),
}
_PIECES = {"dataset": ("shard-*.npz", "manifest.json"), "training": ("checkpoints", "round-0")}  # they tell their key


class StagePaths(NamedTuple):
    """Where a stage keeps its things."""

    folder: pathlib.Path
    record: pathlib.Path  # store/record.py
    summary: pathlib.Path  # there when the stage is done
    results: tuple[pathlib.Path, ...]  # files, and folders with all that is in them


def stage_paths(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> StagePaths:
    """The paths of a stage. Evaluations by different backends stand side by side in one folder."""
    if stage == "evaluation":
        folder, backend = run_dir / "evaluation", experiment.evaluation.backend
        files = tuple(folder / f"{backend}{end}" for end in (".json", ".npz", "-traces.npz"))
        return StagePaths(folder, folder / "stages" / f"{backend}.json", files[0], files)
    if stage == "report":
        folder, page = run_dir / "figures", run_dir / "report.html"
        return StagePaths(folder, folder / "stage.json", page, (page, folder, run_dir / "videos"))
    folder = run_dir / stage
    return StagePaths(folder, folder / "stage.json", folder / "summary.json", (folder,))


def stage_key(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> str:
    """The key of a stage's result, known before anything is made."""
    foreign = {}
    if stage in ("evaluation", "report") and experiment.robot.name != OWN:
        from agile_jax.robot import robot_digest  # loads MuJoCo

        foreign["robot"] = robot_digest(experiment.robot) or ""
    manifest = read_json(run_dir / "dataset" / "manifest.json") or {}
    if manifest.get("source") == ELSEWHERE:
        foreign["labels"] = str(manifest.get("dataset_hash"))
    return keys(experiment.model_dump(mode="json"), foreign)[ARTEFACTS_OF[stage][0].name]


def begun_record(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> Record:
    """The record of a stage that is to be made now."""
    artefacts, tables = ARTEFACTS_OF[stage], experiment.model_dump(mode="json")
    asked = {dotted: amount for one in artefacts for dotted, amount in amounts(one, tables).items()}
    if stage == "evaluation":  # no amount, but it must be written, too
        asked["evaluation.name"] = experiment.evaluation.name
    key, inputs = stage_key(run_dir, experiment, stage), _inputs(run_dir, stage)
    return Record(stage, key, asked, described(artefacts[0], tables), inputs)


def finish_record(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> None:
    """Note that a stage is done, with the sha256 of its files."""
    paths = stage_paths(run_dir, experiment, stage)
    files = list_files(run_dir, *paths.results)
    summary = None if stage == "report" else read_json(paths.summary)
    record = begun_record(run_dir, experiment, stage)
    write_record(paths.record, record._replace(files=files, summary=summary))


def stage_state(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> State:
    """What the run directory holds of a stage; every file of what is said to be done has been checked.

    "begun" is also what is damaged, or grows: the command that makes the stage goes on with what is sound. "outdated"
    is a report that is older than what it tells of. "other settings" is said of the dataset and the training only.
    """
    paths, wanted = stage_paths(run_dir, experiment, stage), begun_record(run_dir, experiment, stage)
    record = read_record(paths.record)
    if record is None:
        return _state_without_record(paths, stage, wanted)
    if record.key != wanted.key or _shrinks(record, wanted):
        if stage in _PIECES:
            return "other settings"
        return "outdated" if stage == "report" and record.files is not None else "new"
    if record.files is None or record.amounts != wanted.amounts:
        return "begun"
    if any(wanted.inputs.get(name, digest) != digest for name, digest in record.inputs.items()):
        return "outdated" if stage == "report" else "begun"
    if stage == "report" and wanted.inputs.keys() != record.inputs.keys():
        return "outdated"
    return "begun" if damaged(run_dir, record.files) else "done"


def repair_summary(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> None:
    """Write a finished stage's summary anew from its record, where it alone is damaged."""
    paths = stage_paths(run_dir, experiment, stage)
    record = read_record(paths.record)
    if record is None or record.files is None or record.summary is None:
        return
    if damaged(run_dir, record.files) == [paths.summary.relative_to(run_dir).as_posix()]:
        write_json(paths.summary, record.summary)


def refuse_other_settings(run_dir: pathlib.Path, experiment: Experiment, stages: tuple[str, ...]) -> None:
    """Raise BadInput for a folder made with other settings: every differing key, both values, the ways out."""
    for stage in stages:
        if stage_state(run_dir, experiment, stage) == "other settings":
            found = "\n".join(f"  {line}" for line in what_differs(run_dir, experiment, stage))
            raise BadInput(
                f"{stage_paths(run_dir, experiment, stage).folder}: was made with other settings:\n{found}\n"
                "use `--run-dir DIR` for a new run directory, or `--overwrite` to move the old folder aside"
            )


def what_differs(run_dir: pathlib.Path, experiment: Experiment, stage: str) -> list[str]:
    """In what the settings with which a stage was made differ from the experiment's, one a line."""
    paths, wanted = stage_paths(run_dir, experiment, stage), begun_record(run_dir, experiment, stage)
    record = read_record(paths.record)
    there: object = None if record is None else record.settings
    if there is None and stage == "dataset":
        there = (read_json(paths.folder / "manifest.json") or {}).get("settings")
    if there is None:
        return [f"it has no readable {paths.record.name}, so nothing tells with which settings it was made"]
    found = differences(there, wanted.settings)
    found += differences(record.amounts, wanted.amounts) if record is not None else []
    return found or ["another robot, plugin or version of this program"]


def _state_without_record(paths: StagePaths, stage: str, wanted: Record) -> State:
    """What a folder holds whose record is missing or damaged: its pieces tell by themselves what they are of."""
    names = {path.name for path in paths.folder.iterdir()} if paths.folder.is_dir() else set()
    names = {name for name in names if name != paths.record.name and not name.endswith(".tmp")}
    if stage not in _PIECES:
        return "new"
    if paths.folder.exists() and not paths.folder.is_dir():
        return "other settings"
    if not names:
        return "new"
    if not any(pathlib.PurePath(name).match(pattern) for name in names for pattern in _PIECES[stage]):
        return "other settings"
    manifest = read_json(paths.folder / "manifest.json") if stage == "dataset" else None
    if manifest is None or manifest.get("source") == ELSEWHERE or manifest.get("key") == wanted.key:
        return "begun"
    return "other settings"


def _shrinks(record: Record, wanted: Record) -> bool:
    """Whether less is asked for of what cannot be cut."""
    for name in ARTEFACTS_OF[record.stage][0].only_grows:
        there, asked = record.amounts.get(name), wanted.amounts.get(name)
        if isinstance(there, int) and isinstance(asked, int) and asked < there:
            return True
    return False


def _inputs(run_dir: pathlib.Path, stage: str) -> dict[str, str]:
    """Digests of what a stage is made from, as far as it is there: of a report, of every file that it shows."""
    if stage == "report":
        shown = [run_dir / "experiment.toml", *sorted(run_dir.glob("dataset/*.json"))]
        shown += [path for end in ("json", "jsonl", "npz") for path in sorted(run_dir.glob(f"training/*.{end}"))]
        shown += [path for end in ("json", "npz") for path in sorted(run_dir.glob(f"evaluation/*.{end}"))]
        return list_files(run_dir, *shown)
    manifest = read_json(run_dir / "dataset" / "manifest.json") or {}
    if stage == "training" and isinstance(manifest.get("dataset_hash"), str):
        return {"labels": str(manifest["dataset_hash"])}
    if stage == "evaluation":
        finished = read_finished(run_dir / "training")
        return {} if finished is None else {"epochs": finished.policy}
    return {}


def move_aside(folder: pathlib.Path) -> pathlib.Path:
    """Rename `folder` to the first free `<folder>.old-<n>`, n = 1, 2, ..., and return that."""
    number = 1
    while (aside := folder.with_name(f"{folder.name}.old-{number}")).exists():
        number += 1
    folder.rename(aside)
    return aside


def write_identity(run_dir: pathlib.Path, experiment: Experiment) -> None:
    """Write experiment.toml (all settings, resolved), the robot's own files, and environment.json (hashes, seed,
    versions, machine).
    """
    write_atomic(run_dir / "experiment.toml", to_toml(with_own_robot(run_dir, experiment)).encode())
    write_json(
        run_dir / "environment.json",
        {
            "experiment_hash": experiment_hash(experiment),
            "keys": {stage: stage_key(run_dir, experiment, stage) for stage in ARTEFACTS_OF},
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
def locked(run_dir: pathlib.Path) -> Iterator[Callable[[], None]]:
    """Hold the run directory alone. The kernel frees the lock when the process ends, however it ends.

    Gives a function that raises OSError when the folder has been removed or replaced since.

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

        def check() -> None:
            try:
                same = os.path.samestat(os.fstat(file.fileno()), (run_dir / ".lock").stat())
            except OSError:
                same = False
            if not same:
                raise OSError(f"{run_dir}: was removed or replaced during the work; the same command makes it anew")

        yield check
