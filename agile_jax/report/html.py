"""The report of a run directory: one HTML file that stands alone, beside the figures and videos it shows."""

import pathlib
from collections.abc import Callable

from agile_jax.experiment import Experiment
from agile_jax.files import write_atomic
from agile_jax.progress import Progress, silent
from agile_jax.report import run_figures, sections
from agile_jax.report.page import Section, page, paragraph
from agile_jax.report.reading import read_json
from agile_jax.report.video.rendering_record import write_record
from agile_jax.settings import BadInput


def write_report(run_dir: pathlib.Path, experiment: Experiment, progress: Progress = silent) -> pathlib.Path:
    """Write `report.html`, `figures/*.png` and `videos/*.mp4` of a run.

    What the run does not hold yet is left out with a sentence. `rendering_notes(run_dir)` tells what
    to install for better pictures.

    Args:
        run_dir: as the pipeline leaves it (docs/architecture.md); any stage may be missing.
        experiment: the run's settings.
        progress: is told of what comes next.

    Returns:
        The path of the HTML file.

    Raises:
        OSError: the folder cannot be written.
    """

    def guarded(part: Callable[[], str]) -> str:
        try:
            return part()
        except BadInput as error:
            return paragraph(f"Left out: {str(error).replace(f'{run_dir}/', '')}")

    backends = [path.stem for path in sorted((run_dir / "evaluation").glob("*.json"))]
    total = 3 + len(backends)
    problems: list[str] = []
    dataset = _read(run_dir / "dataset" / "summary.json", run_dir, problems)
    training = _read(run_dir / "training" / "summary.json", run_dir, problems)
    evaluations = {name: _read(run_dir / "evaluation" / f"{name}.json", run_dir, problems) or {} for name in backends}

    progress("page", 0, total, "planned paths")
    plan = guarded(lambda: run_figures.paths(run_dir, experiment))
    progress("page", 1, total, "learned field")
    floor = (training or {}).get("noise_floor_mse")
    learning = guarded(lambda: sections.training_table(training))
    learning += guarded(lambda: run_figures.learning_curve(run_dir, floor if isinstance(floor, float) else None))
    learning += guarded(lambda: run_figures.velocity_field(run_dir, experiment))
    learning += guarded(lambda: run_figures.kinematic_test(run_dir, experiment))
    results, pictures, records = [], "", {}
    for number, backend in enumerate(backends):
        progress("page", 2 + number, total, f"episodes of {backend}")
        body = sections.evaluation_table(evaluations[backend])
        try:
            shown, moving, rendered = run_figures.evaluation(run_dir, experiment, backend)
        except BadInput as error:
            shown, moving, rendered = paragraph(f"Left out: {str(error).replace(f'{run_dir}/', '')}"), "", None
        if rendered:
            records[backend] = rendered._asdict()
        pictures += moving
        results.append(Section(f"evaluation-{backend}", f"Evaluation: {backend}", body + shown))
    write_record(run_dir, records)
    progress("page", total - 1, total, "text")

    overview = sections.overview(dataset, training, evaluations) + "".join(paragraph(text) for text in problems)
    parts = [
        Section("overview", "Overview", overview),
        Section("video", "The robot", pictures or paragraph("No episode has been recorded yet.")),
        Section("paths", "Planned paths", plan),
        *(results or [Section("evaluation", "Evaluation", paragraph("The policy has not been evaluated yet."))]),
        Section("policy", "Policy", learning),
        Section("dataset", "Dataset", guarded(lambda: sections.dataset_table(dataset))),
        sections.settings_section(run_dir),
        Section("environment", "Environment", guarded(lambda: sections.environment_table(run_dir))),
    ]
    path = run_dir / "report.html"
    subtitle = "From optimal control to a robot that walks and crawls to its target: what this run did, and how well."
    write_atomic(path, page(experiment.name, subtitle, parts).encode())
    progress("page", total, total)
    return path


def _read(path: pathlib.Path, run_dir: pathlib.Path, problems: list[str]) -> dict | None:
    """The summary, None when it is missing or damaged; the latter is added to `problems`."""
    try:
        return read_json(path)
    except BadInput as error:
        problems.append(str(error).replace(f"{run_dir}/", ""))
        return None
