"""Reading the training's metrics. Loads no heavy library."""

import json
import pathlib

from agile_jax.settings import BadInput

Summary = dict[str, object]


def read_metrics(path: pathlib.Path) -> list[Summary]:
    """The lines of a `metrics.jsonl`; a torn last line is left out.

    Raises:
        BadInput: another line is not a JSON object.
    """
    rows: list[Summary] = []
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            row = json.loads(line)
        except ValueError as error:
            if number == len(lines):
                break
            raise BadInput(f"{path}, line {number}: not JSON ({error})") from error
        if not isinstance(row, dict):
            raise BadInput(f"{path}, line {number}: not a JSON object")
        rows.append(row)
    return rows
