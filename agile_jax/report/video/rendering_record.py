"""With what a run's pictures were made, kept beside them, so that the command line can say what to install."""

import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

from agile_jax.files import read_json, write_json

if TYPE_CHECKING:
    from agile_jax.report.video.video import Rendered

_NAME = "figures/rendering.json"


def write_record(run_dir: pathlib.Path, records: Mapping[str, "Rendered"]) -> None:
    """Keep how the pictures of each evaluation's backend were rendered."""
    write_json(run_dir / _NAME, {backend: rendered._asdict() for backend, rendered in records.items()})


def rendering_notes(run_dir: pathlib.Path) -> list[str]:
    """The distinct notes on missing OpenGL of a run's last report, each one line; none where all is well."""
    records = read_json(run_dir / _NAME) or {}
    notes = [record.get("note") for record in records.values() if isinstance(record, dict)]
    return list(dict.fromkeys(note for note in notes if isinstance(note, str)))
