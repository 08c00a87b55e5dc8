"""The learning curve: metrics.jsonl, and TensorBoard event files beside it.

A line of metrics.jsonl holds nothing that depends on the clock, so that a resumed training writes the same bytes.
The rows up to a checkpoint travel inside it; on resumption the file is written anew from there, which also mends a
torn last line.
"""

import json
import pathlib
from types import TracebackType
from typing import Any

from tensorboardX import SummaryWriter

from agile_jax.files import write_atomic

Row = dict[str, Any]


class MetricsLog:
    """Appends one row an epoch to both. Use it as a context manager."""

    def __init__(self, directory: pathlib.Path, rows: list[Row]):
        """Begin in `directory` after `rows`, the epochs that are already done."""
        self.rows = list(rows)
        self._path = directory / "metrics.jsonl"
        write_atomic(self._path, "".join(_line(row) for row in rows).encode())
        # Events of epochs that are done again are dropped by TensorBoard from purge_step on.
        self._writer = SummaryWriter(str(directory / "tensorboard"), purge_step=len(rows) + 1)
        self._file = self._path.open("a", encoding="utf-8")

    def append(self, row: Row) -> None:
        """Add the row of one epoch."""
        self.rows.append(row)
        self._file.write(_line(row))
        self._file.flush()
        for name in ("train_mse", "validation_mse", "learning_rate"):
            self._writer.add_scalar(name, row[name], row["epoch"])

    def __enter__(self) -> "MetricsLog":
        """The log itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close both files."""
        self._file.close()
        self._writer.close()


def _line(row: Row) -> str:
    return json.dumps(row, sort_keys=True, allow_nan=False) + "\n"
