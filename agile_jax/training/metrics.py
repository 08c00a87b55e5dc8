"""The learning curve: metrics.jsonl, and TensorBoard event files beside it.

A line of metrics.jsonl holds nothing that depends on the clock, so that a resumed training writes the same bytes.
The rows up to a checkpoint travel inside it; on resumption the file is written anew from there, which also mends a
torn last line.
"""

import json
import pathlib

import numpy as np
from jaxtyping import Float
from tensorboardX import SummaryWriter

from agile_jax.files import write_atomic
from agile_jax.settings import BadInput

Row = dict[str, int | float | list[float]]
"""An epoch's line: epoch and step (from 1), errors [(m/s)^2, (rad/s)^2] and the learning rate of its last step; with
several seeds their errors, too; where there was an intermediate test, what it found."""
REMEDY = (
    "lower training.learning_rate, warm up (training.warmup), set training.clip_norm, "
    'training.initialisation = "torch_uniform" or training.optimizer = "adam"'
)
SCALARS = ("train_mse", "validation_mse", "learning_rate")


class MetricsLog:
    """Appends one row an epoch, to the files too if they are asked for. Use it as a context manager."""

    def __init__(self, directory: pathlib.Path | None, rows: list[Row]):
        """Begin after `rows`, the epochs that are already done; in `directory`, or without files."""
        self._file, self._writer = None, None
        if directory is not None:
            path = directory / "metrics.jsonl"
            write_atomic(path, "".join(_line(row) for row in rows).encode())
            # Events of epochs that are done again are dropped by TensorBoard from purge_step on.
            self._writer = SummaryWriter(str(directory / "tensorboard"), purge_step=len(rows) + 1)
            self._file = path.open("a", encoding="utf-8")

    def append(self, row: Row) -> None:
        """Add the row of one epoch."""
        if self._file is not None and self._writer is not None:
            self._file.write(_line(row))
            self._file.flush()
            for name in SCALARS:
                self._writer.add_scalar(name, row[name], row["epoch"])

    def __enter__(self) -> "MetricsLog":
        """The log itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the files."""
        if self._file is not None and self._writer is not None:
            self._file.close()
            self._writer.close()


def epoch_row(losses: Float[np.ndarray, "S steps"], validation: Float[np.ndarray, " S"], number: int) -> Row:
    """The row of epoch `number`, from 0: means over the seeds. train_mse is the mean of the batches' errors, each
    before its step.

    Raises:
        BadInput: a number is not finite.
    """
    seeds, steps = losses.shape
    where = "" if seeds == 1 else " of one of the seeds"
    if not np.isfinite(losses).all():
        bad = number * steps + int(np.argmin(np.isfinite(losses).all(0))) + 1
        raise BadInput(f"training diverged: the loss{where} at step {bad} (epoch {number + 1}) is not finite; {REMEDY}")
    if not np.isfinite(validation).all():
        raise BadInput(
            f"training diverged: the validation error{where} after step {(number + 1) * steps} (epoch {number + 1}) "
            f"is not finite; {REMEDY}"
        )
    means = losses.mean(1, dtype=np.float64)
    row: Row = {
        "epoch": number + 1,
        "step": (number + 1) * steps,
        "train_mse": float(means.mean()),
        "validation_mse": float(validation.mean(dtype=np.float64)),
    }
    if seeds > 1:
        row |= {"train_mse_by_seed": means.tolist(), "validation_mse_by_seed": validation.tolist()}
    return row


def _line(row: Row) -> str:
    return json.dumps(row, sort_keys=True, allow_nan=False) + "\n"
