"""The record of a finished training: which checkpoint is its result. Loads no JAX.

    finished.json    {"step", "sha256", "policy"}: the checkpoint that was reached, the hash of its integrity.json, and
                     that of the policy's numbers, which a repair leaves as it is

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
    policy: str  # sha256 of the policy's numbers


def write_finished(directory: pathlib.Path, step: int, policy: str) -> None:
    """Note that the training in a directory has ended with a checkpoint, whose policy has this hash."""
    digest = sha256((directory / CHECKPOINTS / str(step) / INTEGRITY).read_bytes())
    write_json(directory / FINISHED, {"step": step, "sha256": digest, "policy": policy})


def read_finished(directory: pathlib.Path) -> Finished | None:
    """What the training in a directory has ended with; None when it has not."""
    record = read_json(directory / FINISHED) or {}
    step, digest, policy = (record.get(name) for name in ("step", "sha256", "policy"))
    if isinstance(step, int) and isinstance(digest, str) and isinstance(policy, str):
        return Finished(step, digest, policy)
    return None
