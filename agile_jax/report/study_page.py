"""The page of a study: its figure, what it says in words, and all its rows. One file that stands alone."""

import pathlib
from collections.abc import Mapping, Sequence

from agile_jax.files import write_atomic
from agile_jax.report import definitions
from agile_jax.report.figures.study_figures import Curves, study_figure
from agile_jax.report.figures.style import save_figure
from agile_jax.report.page import Section, page, paragraph, picture, table
from agile_jax.report.sections import settings_section
from agile_jax.scene import SceneSettings

CAPTION = (
    "Success rate with its 95 % Wilson interval, least clearance of the whole robot in an episode, and arrival time "
    "over that of the expert's own path, each from the same distribution of starts."
)
BRANCHES = (
    "starts_X counts the starts from which the expert's path has the branch X (under: below an obstacle, left, right: "
    "round it, direct: past nothing), successes_X how many of these succeeded."
)


def write_study_page(
    study_dir: pathlib.Path,
    name: str,
    axis: str,
    curves: Curves,
    words: Sequence[str],
    rows: Sequence[Mapping[str, object]],
    scene: SceneSettings,
) -> pathlib.Path:
    """Write `study.png` and `study.html` of a study with at least one value that is done.

    Args:
        study_dir: holds `experiment.toml`.
        name: of the experiment.
        axis: what the varied number is called, with its unit.
        curves: the values that are done.
        words: what the study says, in sentences.
        rows: of study.json.
        scene: without what is varied.

    Returns:
        The path of the HTML file.
    """
    figure = picture(save_figure(study_figure(curves, axis), study_dir / "study.png"), CAPTION)
    said = "".join(paragraph(word) for word in words)
    meaning = [definitions.success(), definitions.ARRIVAL, definitions.obstacles(scene), BRANCHES]
    shown = [column for column in rows[0] if column != "hash"]
    values = table(shown, ([row[column] for column in shown] for row in rows))
    parts = [
        Section("study", "What was varied", said + figure),
        Section("values", "All values", values),
        Section("meaning", "What the words mean", "".join(paragraph(text) for text in meaning if text)),
        settings_section(study_dir),
    ]
    path = study_dir / "study.html"
    write_atomic(path, page(name, f"A study: success against {axis}.", parts).encode())
    return path
