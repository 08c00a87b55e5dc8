"""The record of a finished training: which checkpoint is its result. Loads no JAX.

    finished.json    {"step", "sha256"}: the checkpoint that was reached, and the hash of its integrity.json

It is written when the last epoch's checkpoint is whole, and removed before a training goes on to more epochs.
"""

import pathlib
from typing import NamedTuple

from agile_jax.files import read_json, sha256, write_json

FINISHED, INTEGRITY, CHECKPOINTS = "finished.json", "integrity.json", "checkpoints"


class Finished(NamedTuple):
    """What a finished training has reached."""

    step: int  # epochs
    digest: str  # sha256 of the checkpoint's integrity.json, which holds those of its other files


def write_finished(directory: pathlib.Path, step: int) -> None:
    """Note that the training in a directory has ended with a checkpoint."""
    digest = sha256((directory / CHECKPOINTS / str(step) / INTEGRITY).read_bytes())
    write_json(directory / FINISHED, {"step": step, "sha256": digest})


def read_finished(directory: pathlib.Path) -> Finished | None:
    """What the training in a directory has ended with; None when it has not."""
    record = read_json(directory / FINISHED) or {}
    step, digest = record.get("step"), record.get("sha256")
    return Finished(step, digest) if isinstance(step, int) and isinstance(digest, str) else None


def result_files(directory: pathlib.Path) -> list[pathlib.Path]:
    """All files that are the result of a finished training stage, in a fixed order."""
    finished = read_finished(directory)
    if finished is None:
        return []
    checkpoint = directory / CHECKPOINTS / str(finished.step)
    names = ("summary.json", "metrics.jsonl", FINISHED, "kinematic_test.npz", "test_errors.npz")
    return [*(directory / name for name in names), *sorted(path for path in checkpoint.rglob("*") if path.is_file())]
